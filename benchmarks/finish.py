"""What a finish on pixels is worth: PSNR of a picture all of whose pixels are free, as a Markdown table.

python -m benchmarks.finish    # two minutes
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from examples.convergence.case import photograph
from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host
from loi_core.support.markdown import markdown

__all__ = ["main"]

SIDE: Final = 24
STEPS: Final = (100, 300, 1000)
SEEDS: Final = range(3)
WAYS: Final[dict[str, tuple[Callable[[Host], Any], dict[str, Any]]]] = {
    "ours": (LOIObjective, {}),
    'ours, `finish="pixels"`': (LOIObjective, {"finish": "pixels"}),
    "pixel L2": (PixelL2, {}),
}


class Picture:
    """The simplest texture: what it shows are its texels, and they begin grey."""

    def parameters(self) -> Parameters:
        """The texels, shape (H, W, 3)."""
        return {"texels": np.full((SIDE, SIDE, 3), 0.5)}

    def render(self, params: Parameters, *, seed: int = 0) -> Array:  # noqa: ARG002  # of the contract
        """The texels."""
        return params["texels"]

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Callable[[Array], Parameters]]:
        """The texels, and the pullback."""
        return self.render(params, seed=seed), lambda cotangent: {"texels": cotangent}


def main() -> None:
    """Print the table."""
    rows = []
    for name, (objective, options) in WAYS.items():
        cells = []
        for steps in STEPS:
            found = []
            for seed in SEEDS:
                target = photograph(SIDE, SIDE, np.random.default_rng(seed))
                free = {"texels": Free(None, 0.0, 1.0)}
                result = fit(Picture(), objective(target), steps=steps, optimise=free, **options)
                found.append(result.psnr or 0.0)
            cells.append(f"{np.mean(found):.1f}")
        rows.append([name, *cells])
    print("\n".join(markdown(["", *(f"{steps} steps" for steps in STEPS)], rows)))


if __name__ == "__main__":
    main()

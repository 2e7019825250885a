"""What painting disks and pulling back costs: ``python -m benchmarks.disks``, from the root of the repository.

Image and pullback of all parameters, float32 outside and float64 inside, medians of several. Time should grow with the
pixels that disks cover, not with disks times pixels.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

import loi_jax.renderers
import loi_torch.renderers
from loi_core import renderers

MAKERS: Final[dict[str, Callable[..., Any]]] = {
    "NumPy": renderers.Disks,
    "torch": loi_torch.renderers.Disks,
    "JAX, whole canvas": loi_jax.renderers.Disks,
}
SCENES: Final = ((16, 10.0, 128), (64, 5.0, 128), (256, 2.5, 128), (256, 5.0, 128), (1024, 2.5, 256), (1024, 5.0, 256))
TURNS: Final = 7
WHOLE: Final = 64  # disks up to which those are timed that paint each on the whole canvas


def milliseconds(make: Callable[..., Any], count: int, radius: float, side: int) -> float:
    """Median time of image and pullback."""
    rng = np.random.default_rng(0)
    disks = make(
        side,
        side,
        rng.uniform(0, side, (count, 2)).tolist(),
        radius,
        rng.uniform(size=(count, 3)).tolist(),
        dtype="float32",
    )
    params = disks.parameters()
    seconds = []
    for _ in range(TURNS + 1):
        started = time.perf_counter()
        image, pullback = disks.render_vjp(params)
        {name: np.asarray(value) for name, value in pullback(image).items()}  # waits for JAX
        seconds.append(time.perf_counter() - started)
    return 1e3 * statistics.median(seconds[1:])


def main() -> None:
    """Print the table."""
    print(f"| disks | radius | side | covered, pixels | {' | '.join(MAKERS)} |\n|{' --- |' * (4 + len(MAKERS))}")
    for count, radius, side in SCENES:
        cells = [
            "" if name.startswith("JAX") and count > WHOLE else f"{milliseconds(make, count, radius, side):.1f} ms"
            for name, make in MAKERS.items()
        ]
        covered = round(count * np.pi * radius**2)
        print(f"| {count} | {radius:g} | {side} | {covered} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

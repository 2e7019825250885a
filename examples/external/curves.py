"""Draw the share of solved starts against their distance: ``python -m examples.external.curves``.

Three disks start at one distance from their goals, against a photograph as bright as the render and a darker one.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from examples.external.disks import DISKS, PHOTOGRAPHS, disks_at
from examples.external.methods import METHODS
from examples.external.problem import Method
from examples.external.running import summary
from examples.plots import new_figure, png_of
from loi_core.io.files import write_bytes

DISTANCES_PX: Final = (8.0, 16.0, 24.0, 32.0, 40.0)
PANELS: Final = ("x 1", "x 0.9")
METHOD_NAMES: Final = ("loi", "loi, matched", "pixel L2", "Gaussian pyramid", "MS-SSIM", "random search", "CMA-ES")


def solved_shares(method: Method, photograph: str, starts: int) -> list[float]:
    """Return the share of solved starts at every distance."""
    gain, offset = PHOTOGRAPHS[photograph]
    shares = []
    for distance in DISTANCES_PX:
        problem = replace(DISKS[0], make=partial(disks_at, (distance, distance), gain, offset))
        shares.append(summary(problem, method, range(starts)).solved / starts)
        print(f"{method.name}, {photograph}, {distance:g} px: {shares[-1]:.0%}", flush=True)
    return shares


def drawn(shares: Mapping[tuple[str, str], Sequence[float]]) -> bytes:
    """Return the figure of the shares by photograph and method as a PNG."""
    figure = new_figure(8.5, 3.0)
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for panel, photograph in zip(axes, PANELS, strict=True):
        for (photograph_of_curve, name), values in shares.items():
            if photograph_of_curve == photograph:
                width = 2.4 if name.startswith("loi") else 1.1
                panel.plot(DISTANCES_PX, values, marker="o", markersize=3.0, lw=width, label=name)
        panel.set(title=f"photograph {photograph}", xlabel="distance of every disk in pixels", ylim=(-0.05, 1.05))
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("share of solved starts")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8)
    return png_of(figure)


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m examples.external.curves", description=__doc__)
    parser.add_argument("--starts", type=int, default=8, help="number of starts at each distance")
    parser.add_argument("--output", type=Path, default=Path("docs/results/images/external-disks.png"))
    options = parser.parse_args()
    methods = [method for method in METHODS if method.name in METHOD_NAMES and not method.missing()]
    shares = {
        (photograph, method.name): solved_shares(method, photograph, options.starts)
        for photograph in PANELS
        for method in methods
    }
    write_bytes(options.output, drawn(shares))
    print(options.output)


if __name__ == "__main__":
    main()

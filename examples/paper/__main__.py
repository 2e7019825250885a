"""``python -m examples.paper NAME ...``: run one of the paper's experiments; ``NAME --help`` lists its options."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Final

EXPERIMENTS: Final = {
    "figures1d": ("figures.figures1d", "one-dimensional figures, and the width of each method's basin (minutes)"),
    "guidance": ("table1.guidance", "the direction of the gradient for many disks of random colours (minutes)"),
    "kaleidoscope": ("variational.kaleidoscope", "mirrors and beads, with gradients from images alone (an hour)"),
    "mug": ("variational.mug", "a mug whose handle is hidden, with gradients from images at other angles (minutes)"),
    "orb": ("variational.orb", "a glass orb on a table, with gradients from images alone (an hour)"),
    "shadow": ("table2.shadow", "the paper's first scene, lit by a point light, from ten starts (half an hour)"),
    "table1": ("table1", "disks fitted from random starts by every method (hours)"),
    "table2": ("table2", "shadows, caustics, 65 primitives and a highlight, through a path tracer (hours)"),
    "table3": ("table3", "poses, shapes, cameras, materials and light, through a mesh rasteriser (hours)"),
    "teaser": (
        "figures.teaser",
        "the paper's first figure: a light located by its highlight on a glossy ball (minutes)",
    ),
}
"""By name, a module of this package whose `main` takes the arguments, and its description."""


def main() -> None:
    """Run the experiment named by the first argument with the remaining arguments."""
    descriptions = "\n".join(f"  {name:<13} {description}" for name, (_, description) in EXPERIMENTS.items())
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper",
        description="Run one of the paper's experiments. NAME --help lists its options; --quick runs it small.",
        epilog=f"experiments:\n{descriptions}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", choices=EXPERIMENTS, help="experiment, see below")
    name = parser.parse_args(sys.argv[1:2]).name
    importlib.import_module(f"examples.paper.{EXPERIMENTS[name][0]}").main(sys.argv[2:])


if __name__ == "__main__":
    main()

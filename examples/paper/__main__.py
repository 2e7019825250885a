"""``python -m examples.paper NAME ...``: run one of the paper's experiments; ``NAME --help`` has its options."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Final

# Of this package, each with a `main` that takes the arguments.
EXPERIMENTS: Final = {
    "figures1d": "the one-dimensional figures, and how wide the basin of every method is (minutes)",
    "guidance": "which way the loss sends each of many disks of random colours (minutes)",
    "kaleidoscope": "mirrors and beads, by gradients from images alone (an hour; what is done is kept)",
    "mug": "a handle that is turned away, found by looking at other angles (minutes)",
    "orb": "a glass orb on a table, by gradients from images alone (an hour; what is done is kept)",
    "shadow": "the paper's first scene, under its point light, from ten starts (half an hour)",
    "table1": "disks found from random starts by every method (hours; what is done is kept)",
    "table2": "shadows, caustics, 65 primitives and a highlight, through a path tracer (hours; what is done is kept)",
    "teaser": "the paper's first figure: a lamp found from its highlight on a shiny ball (minutes)",
    "table3": "poses, shapes, cameras, materials and light, through a mesh rasterizer (hours; what is done is kept)",
}


def main() -> None:
    """Hand the arguments to the experiment that is named first."""
    listed = "\n".join(f"  {name:<13} {about}" for name, about in EXPERIMENTS.items())
    parser = argparse.ArgumentParser(
        prog="python -m examples.paper",
        description="Run one of the paper's experiments. NAME --help has its options, --quick among them.",
        epilog=f"experiments:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", choices=EXPERIMENTS, help="the experiment, see below")
    name = parser.parse_args(sys.argv[1:2]).name
    importlib.import_module(f"examples.paper.{name}").main(sys.argv[2:])


if __name__ == "__main__":
    main()

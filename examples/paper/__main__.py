"""``python -m examples.paper NAME ...``: run one of the paper's experiments; ``NAME --help`` has its options."""

from __future__ import annotations

import importlib
import sys
from typing import Final

EXPERIMENTS: Final = ("figures1d", "table1")  # of this package, each with a `main` that takes the arguments


def main() -> None:
    """Hand the arguments to the experiment that is named first."""
    if len(sys.argv) < 2 or sys.argv[1] not in EXPERIMENTS:
        sys.exit(f"usage: python -m examples.paper {{{','.join(EXPERIMENTS)}}} [--help]")
    importlib.import_module(f"examples.paper.{sys.argv[1]}").main(sys.argv[2:])


if __name__ == "__main__":
    main()

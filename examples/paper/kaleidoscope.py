"""``python -m examples.paper kaleidoscope``: the mirrors' angles and the beads' places, from one image.

All methods have gradients by blurring over the parameters (Fischer and Ritschel, CVPR 2023), each at the best of a
small search.
"""

from __future__ import annotations

from collections.abc import Sequence

from examples.paper.variational.command import run_scene

__all__ = ["main"]


def main(words: Sequence[str] | None = None) -> None:
    """Carry out what is missing and write everything anew."""
    run_scene("kaleidoscope", __doc__, words)


if __name__ == "__main__":
    main()

"""``python -m examples.paper orb``: where a glass orb stands on a table, from what stands in for a photograph.

The paper has a real photograph. Ours is rendered, with wavelengths, by another configuration than the model's, through
a lens and a sensor, with camera and lamp that are 1 % off. All methods have gradients by blurring over the parameters
(Fischer and Ritschel, CVPR 2023), each at the best of a small search.
"""

from __future__ import annotations

from collections.abc import Sequence

from examples.paper.variational.command import run_scene

__all__ = ["main"]


def main(words: Sequence[str] | None = None) -> None:
    """Carry out what is missing and write everything anew."""
    run_scene("orb", __doc__, words)


if __name__ == "__main__":
    main()

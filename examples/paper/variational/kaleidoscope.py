"""``python -m examples.paper kaleidoscope``: the mirrors' angles and the beads' positions, from one image.

All methods differentiate a blur over the parameters (Fischer and Ritschel, CVPR 2023), each with the best settings of a
small search.
"""

from __future__ import annotations

from functools import partial

from examples.paper.variational.command import run_scene

__all__ = ["main"]

main = partial(run_scene, "kaleidoscope", __doc__)

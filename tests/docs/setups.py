"""Names that the blocks of the detailed pages assume. Pages of the guide assume none."""

from __future__ import annotations

from typing import Final

__all__ = ["SETUPS"]

_IMAGES: Final = """
from pathlib import Path
import numpy as np
height, width = 16, 24
photograph = np.full((height, width, 3), 0.7)
"""

SETUPS: Final = {
    "convergence": _IMAGES
    + """
import optax, torch
import loi_jax, loi_torch
from loi_core import FarToNear, Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import Disks
renderer = front = side = Disks(height, width, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])
one = two = photograph
mask = np.ones((height, width))
params, update = renderer.parameters(), lambda params, gradient: params
start, low, high = [[5.0, 9.0]], 0.0, 24.0
objective = LOIObjective(photograph)
_fit = fit
def fit(renderer, *given, optimise=None, **options):  # three steps; the page's "place" is the renderer's "positions"
    return _fit(renderer, *given, steps=3, optimise=optimise and {"positions": optimise["place"]}, **options)
""",
    "tools": _IMAGES
    + """
import loi_core
from loi_core import Free, LOIObjective
from loi_core.renderers import Disks
renderer = Disks(height, width, [[5.0, 9.0]], 3.0, [[1.0, 0.5, 0.2]])
objective, free = LOIObjective(photograph), {"positions": Free([[9.0, 5.0]], 0.0, 24.0)}
""",
}
"""Code to run before the blocks of a page, by the name of the page."""

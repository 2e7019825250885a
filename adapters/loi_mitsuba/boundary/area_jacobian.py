"""What is seen edge-on has no gradient that drowns all others.

Where what is lit moves, Mitsuba keeps the points of lamps, and of whatever else light comes from, and differentiates
the solid angle that their surface has. Relative to itself, its change grows beyond all bounds as a surface is turned
away: under a round lamp the variance of a gradient is infinite, and one sample may outweigh all others together.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import drjit as dr

__all__ = ["LEAST", "clamped_area_jacobian"]

NAME: Final = "solid_angle_to_area_jacobian"  # what Mitsuba's integrators differentiate
LEAST: Final = 0.01  # the cosine below which a surface counts as no more turned: 0.0001 of the light of a round lamp


@contextmanager
def clamped_area_jacobian(integrator: Any) -> Iterator[None]:
    """Have an integrator of Mitsuba bound the relative change of cosines near 0 meanwhile."""
    module = sys.modules.get(type(integrator).__module__)
    own = getattr(module, NAME, None)
    if own is not None:
        setattr(module, NAME, _bounded)
    try:
        yield
    finally:
        if own is not None:
            setattr(module, NAME, own)


def _bounded(o: Any, p: Any, n: Any, active: Any = True) -> Any:  # noqa: FBT002  # as it is called
    """Solid angle to an area at `p`, as it is seen from `o`, with another value where that is next to nothing.

    Mitsuba takes how it changes relative to its value, and nothing else.
    """
    way = p - o
    cosine = dr.abs_dot(n, dr.normalize(way))
    least = dr.maximum(LEAST - dr.detach(cosine), 0.0)
    return dr.select(active, (cosine + least) / dr.squared_norm(way), 1.0)

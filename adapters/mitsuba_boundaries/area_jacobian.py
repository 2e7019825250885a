"""Clamp the grazing-angle term of the area Jacobian, whose relative derivative is unbounded.

Where the lit surface moves, Mitsuba fixes the sampled emitter points and differentiates the solid angle of their area.
The relative derivative of the cosine in it is unbounded at grazing angles: under a spherical emitter the variance of
the gradient is infinite, and a single sample may outweigh all others.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr

from mitsuba_boundaries.integrator_view import with_global

__all__ = ["MIN_COSINE", "clamped_sample"]

FUNCTION: Final = "solid_angle_to_area_jacobian"  # a global of the modules of Mitsuba's integrators
MIN_COSINE: Final = 0.01  # smaller ones carry 0.0001 of the light of a spherical emitter


def clamped_sample(integrator: Any) -> Any:
    """Return the method `sample` of an integrator, with an area Jacobian whose relative derivative is clamped.

    Mitsuba has no hook for it: the Jacobian is a global function of the modules of its integrators, which their methods
    call in the middle of a path. The method here has other globals; Mitsuba's own are left alone.
    """
    return with_global(integrator.sample, FUNCTION, _clamped)


def _clamped(o: Any, p: Any, n: Any, active: Any = True) -> Any:  # noqa: FBT002  # Mitsuba's signature
    """Return the Jacobian from solid angle at `o` to area at `p` with normal `n`, with small cosines raised.

    Mitsuba only uses its derivative relative to its value.
    """
    direction = p - o
    cosine = dr.abs_dot(n, dr.normalize(direction))
    raise_by = dr.maximum(MIN_COSINE - dr.detach(cosine), 0.0)
    return dr.select(active, (cosine + raise_by) / dr.squared_norm(direction), 1.0)

"""Clamp the grazing-angle term of the area Jacobian, whose relative derivative is unbounded.

Where the lit surface moves, Mitsuba fixes the sampled emitter points and differentiates the solid angle of their area.
The relative derivative of the cosine in it is unbounded at grazing angles: under a spherical emitter the variance of
the gradient is infinite, and a single sample may outweigh all others.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import drjit as dr

__all__ = ["MIN_COSINE", "clamped_area_jacobian"]

FUNCTION: Final = "solid_angle_to_area_jacobian"  # a global of the modules of Mitsuba's integrators
MIN_COSINE: Final = 0.01  # smaller ones carry 0.0001 of the light of a spherical emitter


@contextmanager
def clamped_area_jacobian(integrator: Any) -> Iterator[None]:
    """Replace the area Jacobian in the module of an integrator by one with a clamped relative derivative."""
    modules = (sys.modules.get(base.__module__) for base in type(integrator).__mro__)
    module = next((module for module in modules if hasattr(module, FUNCTION)), None)
    original = getattr(module, FUNCTION, None)
    if original is not None:
        setattr(module, FUNCTION, _clamped)
    try:
        yield
    finally:
        if original is not None:
            setattr(module, FUNCTION, original)


def _clamped(o: Any, p: Any, n: Any, active: Any = True) -> Any:  # noqa: FBT002  # Mitsuba's signature
    """Return the Jacobian from solid angle at `o` to area at `p` with normal `n`, with small cosines raised.

    Mitsuba only uses its derivative relative to its value.
    """
    direction = p - o
    cosine = dr.abs_dot(n, dr.normalize(direction))
    raise_by = dr.maximum(MIN_COSINE - dr.detach(cosine), 0.0)
    return dr.select(active, (cosine + raise_by) / dr.squared_norm(direction), 1.0)

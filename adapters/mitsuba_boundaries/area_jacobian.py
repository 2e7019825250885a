"""Correct the area Jacobian of Mitsuba's integrators: its grazing-angle term, and the distance to spot lights.

Where the lit surface moves, Mitsuba fixes the sampled emitter points and differentiates the solid angle of their area.
The relative derivative of the cosine in it is unbounded at grazing angles: under a spherical emitter the variance of
the gradient is infinite, and a single sample may outweigh all others. For spot lights, whose area is zero, Mitsuba
differentiates the falloff with the angle, and not the one with the distance.
"""

from __future__ import annotations

from typing import Any, Final

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.integrator_view import with_global

__all__ = ["MIN_COSINE", "corrected_sample"]

FUNCTION: Final = "solid_angle_to_area_jacobian"  # a global of the modules of Mitsuba's integrators
MIN_COSINE: Final = 0.01  # smaller ones carry 0.0001 of the light of a spherical emitter


def corrected_sample(integrator: Any, scene: Any) -> Any:
    """Return the method `sample` of an integrator, with a corrected area Jacobian for a scene.

    Mitsuba has no hook for it: the Jacobian is a global function of the modules of its integrators, which their methods
    call in the middle of a path. The method here has other globals; Mitsuba's own are left alone.
    """
    return with_global(integrator.sample, FUNCTION, _corrected(_spot_positions(scene)))


def _spot_positions(scene: Any) -> list[Any]:
    """Return the positions, mi.Point3f, of the spot lights of a scene."""
    spots = [emitter for emitter in scene.emitters() if emitter.class_name() == "SpotLight"]
    return [dr.detach(mi.traverse(spot)["to_world"].translation()) for spot in spots]


def _corrected(spot_positions: list[Any]) -> Any:
    """Return the corrected Jacobian of a scene with spot lights at these positions."""

    def jacobian(o: Any, p: Any, n: Any, active: Any = True) -> Any:  # noqa: FBT002  # Mitsuba's signature
        """Return the Jacobian from solid angle at `o` to area at `p` with normal `n`, with small cosines raised.

        For points `p` of spot lights, the inverse square of the distance. Mitsuba only uses the derivative relative to
        the value.
        """
        direction = p - o
        cosine = dr.abs_dot(n, dr.normalize(direction))
        raise_by = dr.maximum(MIN_COSINE - dr.detach(cosine), 0.0)
        value = dr.select(active, (cosine + raise_by) / dr.squared_norm(direction), 1.0)
        for position in spot_positions:
            value = dr.select(dr.all(dr.detach(p) == position), dr.rcp(dr.squared_norm(direction)), value)
        return value

    return jacobian

"""A lamp that lights a cone: what stands in a neighbouring scene for a spot light, which has no size.

Mitsuba's emitters that have one shine to all sides.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import drjit as dr
import mitsuba as mi

__all__ = ["CONE", "register_cone"]

CONE: Final = "loi_cone"
"""The emitter's name, once it is registered."""


def register_cone() -> str:
    """Have the current variant of Mitsuba know the emitter; its name."""
    _register(mi.variant())
    return CONE


@functools.cache
def _register(variant: str) -> None:  # noqa: ARG001  # once for each
    """Register the emitter. Its class is made here, for those that it derives from and uses are the variant's own."""

    class Cone(mi.Emitter):  # type: ignore[misc]  # Mitsuba has no types
        """A sphere that is as bright in a direction as a spot light is: the cone is that around its own z axis.

        Where light goes is told from the sphere's middle, as of the spot, so that a cone's edge is no softer.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.radiance = props.get_emissive_texture("radiance")
            self.cutoff = math.radians(props["cutoff_angle"])
            self.full = math.radians(props["beam_width"])
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback: Any) -> None:
            callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)

        def eval(self, si: Any, active: Any) -> Any:
            lit = si.p + si.to_world(si.wi) * dr.select(dr.isfinite(si.t), si.t, 0.0)
            return self._towards(lit, si, active & (mi.Frame3f.cos_theta(si.wi) > 0.0))

        def sample_direction(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any]:
            ds = self.get_shape().sample_direction(it, sample, active)
            active &= (dr.dot(ds.d, ds.n) < 0.0) & (ds.pdf != 0.0)
            ds.emitter = mi.EmitterPtr(self)
            weight = self.eval_direction(it, ds, active) / ds.pdf
            return ds, dr.select(active, weight, 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any) -> Any:
            pdf = self.get_shape().pdf_direction(it, ds, active)
            return dr.select(dr.dot(ds.d, ds.n) < 0.0, pdf, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any) -> Any:
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            return self._towards(it.p, si, active & (dr.dot(ds.d, ds.n) < 0.0))

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def _towards(self, lit: Any, si: Any, active: Any) -> Any:
            """The radiance at a point of the sphere by where it goes to; as Mitsuba's spot light has it."""
            pose = mi.traverse(self.get_shape())["to_world"]
            along = dr.normalize(pose @ mi.Vector3f(0.0, 0.0, 1.0))
            cosine = dr.dot(dr.normalize(lit - pose @ mi.Point3f(0.0)), along)
            angle = dr.safe_acos(cosine)
            falling = (self.cutoff - angle) / max(self.cutoff - self.full, 1e-6)
            share = dr.select(angle <= self.full, 1.0, dr.maximum(falling, 0.0))
            return dr.select(active, self.radiance.eval(si, active) * share, 0.0)

    mi.register_emitter(CONE, lambda props: Cone(props))

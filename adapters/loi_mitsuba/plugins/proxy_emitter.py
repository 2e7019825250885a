"""The lamp that stands in a neighbouring scene for a light without a size, where Mitsuba's own kinds will not do.

Mitsuba's emitters that have a size shine to all sides, and mirrors show them. Of a point, spot or directional light
there is no image in any mirror, nor light that a mirror throws: no path of the scene itself finds it. So it must not be
in the gradient either, where mirrors are a little rough. But a shadow's edge is where a ray to the lamp passes what
casts it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import drjit as dr
import mitsuba as mi

__all__ = ["hittable_proxy_emitters", "register_proxy_emitter"]

NAME: Final = "loi_area"

_hit: list[None] = []  # one for each `hittable_proxy_emitters` that is going on


@contextmanager
def hittable_proxy_emitters() -> Iterator[None]:
    """Rays that hit a lamp find its light meanwhile; else only what samples lamps does, as of lights without a size."""
    _hit.append(None)
    try:
        yield
    finally:
        _hit.pop()


def register_proxy_emitter() -> str:
    """Have the current variant of Mitsuba know the emitter; its name."""
    _register(mi.variant())
    return NAME


@functools.cache
def _register(variant: str) -> None:  # noqa: ARG001  # once for each
    """Register the emitter. Its class is made here, for those that it derives from and uses are the variant's own."""

    class Lamp(mi.Emitter):  # type: ignore[misc]  # Mitsuba has no types
        """A sphere or disk that is as bright to all sides or, with `cutoff_angle`, in a cone as a spot light is.

        The cone is that around its shape's own z axis. Where light goes is told from the shape's middle, as of the
        spot, so that a cone's edge is no softer.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.radiance = props.get_emissive_texture("radiance")
            self.cutoff = math.radians(props["cutoff_angle"]) if "cutoff_angle" in props else None
            self.full = math.radians(props["beam_width"]) if "beam_width" in props else 0.0
            self.m_flags = mi.EmitterFlags.Surface
            if self.cutoff is not None:
                self.m_flags |= mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback: Any) -> None:
            callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)

        def eval(self, si: Any, active: Any) -> Any:
            if not _hit:
                return mi.Spectrum(0.0)
            lit = si.p + si.to_world(si.wi) * dr.select(dr.isfinite(si.t), si.t, 0.0)
            return self._towards(lit, si, active & (mi.Frame3f.cos_theta(si.wi) > 0.0))

        def sample_direction(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any]:
            ds = self.get_shape().sample_direction(it, sample, active)
            active &= (dr.dot(ds.d, ds.n) < 0.0) & (ds.pdf != 0.0)
            ds.emitter = mi.EmitterPtr(self)
            ds.delta = mi.Bool(not _hit)  # nothing else finds its light then
            weight = self.eval_direction(it, ds, active) / ds.pdf
            return ds, dr.select(active, weight, 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any) -> Any:
            if not _hit:
                return mi.Float(0.0)
            pdf = self.get_shape().pdf_direction(it, ds, active)
            return dr.select(dr.dot(ds.d, ds.n) < 0.0, pdf, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any) -> Any:
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            return self._towards(it.p, si, active & (dr.dot(ds.d, ds.n) < 0.0))

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def _towards(self, lit: Any, si: Any, active: Any) -> Any:
            """The radiance at a point of the lamp by where it goes to; as Mitsuba's spot light has it."""
            radiance = self.radiance.eval(si, active)
            if self.cutoff is not None:
                pose = mi.traverse(self.get_shape())["to_world"]
                along = dr.normalize(pose @ mi.Vector3f(0.0, 0.0, 1.0))
                angle = dr.safe_acos(dr.dot(dr.normalize(lit - pose @ mi.Point3f(0.0)), along))
                falling = (self.cutoff - angle) / max(self.cutoff - self.full, 1e-6)
                radiance *= dr.select(angle <= self.full, 1.0, dr.maximum(falling, 0.0))
            return dr.select(active, radiance, 0.0)

    mi.register_emitter(NAME, lambda props: Lamp(props))

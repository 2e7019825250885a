"""An area emitter that replaces a delta light in proxy scenes.

Delta lights are invisible in mirrors and cast no caustics, because no path can hit them. The proxy must not show them
either, although its mirrors are slightly rough; Mitsuba's own area emitters would. The silhouette of the proxy emitter
is still needed for the edges of shadows, where rays that hit it do count.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final

import drjit as dr
import mitsuba as mi

__all__ = ["hittable_proxy_emitters", "register_proxy_emitter"]

NAME: Final = "proxy_emitter"
MIN_FALLOFF_ANGLE: Final = 1e-6  # radians, of a spot whose beam fills its cone

# Mitsuba has no hook for it: its boundary samples evaluate emitters by `Emitter.eval(si, active)` in the middle of a
# path, as its images do. A context variable has another value in each thread, and is reset after an error.
_hittable: ContextVar[bool] = ContextVar("hittable_proxy_emitters", default=False)


@contextmanager
def hittable_proxy_emitters() -> Iterator[None]:
    """Let rays that hit a proxy emitter see its radiance; otherwise only emitter samples do, as for delta lights."""
    token = _hittable.set(True)
    try:
        yield
    finally:
        _hittable.reset(token)


def register_proxy_emitter() -> str:
    """Register the plugin with Mitsuba's current variant and return its name."""
    _register(mi.variant())
    return NAME


@functools.cache
def _register(variant: str) -> None:  # noqa: ARG001  # once for each variant
    """Register the plugin. Its class is defined here, because the classes that it uses are the variant's own."""

    class ProxyEmitter(mi.Emitter):  # type: ignore[misc]  # Mitsuba has no types
        """A sphere or disk with uniform radiance, or with `cutoff_angle` the falloff of a spot light.

        The cone is around the z axis of the shape. Directions are measured from the centre of the shape, as for the
        spot light, so that the edge of the cone is as sharp as the spot's.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.radiance = props.get_emissive_texture("radiance")
            self.cutoff = math.radians(props["cutoff_angle"]) if "cutoff_angle" in props else None
            self.beam_width = math.radians(props["beam_width"]) if "beam_width" in props else 0.0
            self.m_flags = mi.EmitterFlags.Surface
            if self.cutoff is not None:
                self.m_flags |= mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback: Any) -> None:
            callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)

        def eval(self, si: Any, active: Any) -> Any:
            if not _hittable.get():
                return mi.Spectrum(0.0)
            lit = si.p + si.to_world(si.wi) * dr.select(dr.isfinite(si.t), si.t, 0.0)
            return self._radiance_towards(lit, si, active & (mi.Frame3f.cos_theta(si.wi) > 0.0))

        def sample_direction(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any]:
            ds = self.get_shape().sample_direction(it, sample, active)
            active &= (dr.dot(ds.d, ds.n) < 0.0) & (ds.pdf != 0.0)
            ds.emitter = mi.EmitterPtr(self)
            ds.delta = mi.Bool(not _hittable.get())  # then no other strategy samples it
            weight = self.eval_direction(it, ds, active) / ds.pdf
            return ds, dr.select(active, weight, 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any) -> Any:
            if not _hittable.get():
                return mi.Float(0.0)
            pdf = self.get_shape().pdf_direction(it, ds, active)
            return dr.select(dr.dot(ds.d, ds.n) < 0.0, pdf, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any) -> Any:
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            return self._radiance_towards(it.p, si, active & (dr.dot(ds.d, ds.n) < 0.0))

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def _radiance_towards(self, lit: Any, si: Any, active: Any) -> Any:
            """Return the radiance towards a point, with the falloff of Mitsuba's spot light."""
            radiance = self.radiance.eval(si, active)
            if self.cutoff is not None:
                to_world = mi.traverse(self.get_shape())["to_world"]
                axis = dr.normalize(to_world @ mi.Vector3f(0.0, 0.0, 1.0))
                angle = dr.safe_acos(dr.dot(dr.normalize(lit - to_world @ mi.Point3f(0.0)), axis))
                falloff = (self.cutoff - angle) / max(self.cutoff - self.beam_width, MIN_FALLOFF_ANGLE)
                radiance *= dr.select(angle <= self.beam_width, 1.0, dr.maximum(falloff, 0.0))
            return dr.select(active, radiance, 0.0)

    mi.register_emitter(NAME, lambda props: ProxyEmitter(props))

"""What Mitsuba's projective integrators draw of a gradient: outlines in view, and those of shadows and reflections."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Final, Literal

import drjit as dr
import mitsuba as mi

from loi_mitsuba.geometry.coincident_edges import UniqueEdges
from loi_mitsuba.plugins.proxy_emitter import hittable_proxy_emitters
from loi_mitsuba.sensing.film import Film
from loi_mitsuba.sensing.film_samples import capture_splats, to_rgb
from loi_mitsuba.sensing.sensor import PerspectiveSensor, is_off_centre, ray_epsilon

__all__ = ["ProjectiveBoundary"]

SEEDS: Final = {"sppp": 0xFFFFFFFF, "sppi": 0xAA00AA00}  # by part, those of samples; as in Mitsuba
GUIDE: Final = 0xAFAFAFAF  # that of what says where indirect silhouettes are looked for
TOUCH: Final = 1.0  # of what Mitsuba lifts a ray by, from an edge to what it lies in


class _Shifted:
    """A perspective camera that shows all of its view to a point.

    Where its principal point is not in the middle, Mitsuba's own shows nothing to points that would be out of view if
    it were.

    Parameters
    ----------
    sensor : mi.Sensor
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor, self._eye = sensor, PerspectiveSensor(sensor)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)

    def sample_direction(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Where it is from a point, and its importance; as `mi.Sensor.sample_direction`."""
        ds, _ = self._sensor.sample_direction(it, sample, active)
        _, weight, place, visible = self._eye.project(it.p)
        within = visible & dr.all((place >= 0.0) & (place <= 1.0))
        return ds, mi.Spectrum(dr.select(active & within, weight / math.prod(self._sensor.film().crop_size()), 0.0))


@dataclass(frozen=True)
class ProjectiveBoundary:
    """One part of the gradient of a projective integrator.

    Attributes
    ----------
    sensor : mi.Sensor
    film : Film
        Of the camera.
    part : str
        "sppp", outlines in view, or "sppi", those of what is seen in mirrors, or hides light.
    once : Once or None
        Of "sppi", which points of the edges of meshes count.
    """

    sensor: Any
    film: Film
    part: Literal["sppp", "sppi"]
    once: UniqueEdges | None = None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """At points of silhouettes, 0 with how it changes: the jump times how far they move; and places. None without.

        The seed and `samples`, of each pixel, are those of Mitsuba's `render_backward`.
        """
        if not scene.silhouette_shapes():
            return None
        sensor = self.sensor
        with dr.suspend_grad():
            if self.part == "sppp":
                integrator.proj_detail.init_primarily_visible_silhouette(scene, sensor)
                draw = integrator.render_primarily_visible_silhouette
            else:
                sensor = _Shifted(sensor) if is_off_centre(sensor) else sensor
                integrator.proj_detail.init_indirect_silhouette(scene, sensor, GUIDE ^ seed)
                draw = integrator.render_indirect_silhouette
            sampler, number = integrator.prepare(self.sensor, SEEDS[self.part] ^ seed, samples, integrator.aov_names())
        lamps = hittable_proxy_emitters() if self.part == "sppi" else nullcontext()
        with lamps, self._counted(integrator), capture_splats() as taken:
            draw(scene, sensor, sampler, 1)  # by whose number it is divided below, or each would be compiled anew
        if not taken:
            return None
        (sample,) = taken
        value = to_rgb(sample["value"], sample["wavelengths"], active=sample["active"])
        value = dr.select(sample["active"], value, 0.0) / dr.opaque(mi.Float, number * self.film.sampled)
        return value, dr.detach(sample["pos"]) / mi.Point2f(*map(float, self.film.size))

    @contextmanager
    def _counted(self, integrator: Any) -> Iterator[None]:
        """The integrator meanwhile finds one of several edges of a mesh along a line, and none on what it touches.

        An edge that lies in another side, as where two boxes end in one plane, throws no shadow on it. Rounding puts it
        beside that side, and as close as nothing else is.
        """
        if self.part != "sppi":
            yield
            return
        found, once = integrator.sample_importance, self.once

        def sample_importance(scene: Any, sensor: Any, drawn: Any, *rest: Any) -> Any:
            *before, active = rest
            if once is not None:
                active = active & once.counts(drawn)  # not in place, which would change the integrator's own
            back = mi.SilhouetteSample3f(drawn)
            back.d = -drawn.d
            ray = back.spawn_ray()
            ray.maxt = TOUCH * ray_epsilon(drawn.p)
            return found(scene, sensor, drawn, *before, active & ~scene.ray_test(ray, active=active))

        integrator.sample_importance = sample_importance
        try:
            yield
        finally:
            del integrator.sample_importance

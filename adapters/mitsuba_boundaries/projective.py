"""The boundary term by Mitsuba's projective sampling of silhouettes.

The samples are taken before they reach the film, and sensors with an off-centre principal point are repaired.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Final, Literal

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.geometry.coincident_edges import UniqueEdges
from mitsuba_boundaries.plugins.proxy_emitter import hittable_proxy_emitters
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.sensing.film_samples import capture_splats, to_rgb
from mitsuba_boundaries.sensing.sensor import PerspectiveSensor, is_off_centre, ray_epsilon

__all__ = ["ProjectiveBoundary"]

SEED_MASKS: Final = {"sppp": 0xFFFFFFFF, "sppi": 0xAA00AA00}  # as in Mitsuba's PSIntegrator
GUIDING_SEED_MASK: Final = 0xAFAFAFAF  # likewise
CONTACT_EPSILONS: Final = 1.0  # ray epsilons from a silhouette to a surface that it lies in


class _OffCentreSensor:
    """A perspective camera whose `sample_direction` covers the whole view.

    With an off-centre principal point, Mitsuba's own has zero importance for points that would be out of view if the
    principal point were in the centre.

    Parameters
    ----------
    sensor : mi.Sensor
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor, self._perspective = sensor, PerspectiveSensor(sensor)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)

    def sample_direction(self, it: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Return the direction sample from points to the camera and its importance; see `mi.Sensor`."""
        ds, _ = self._sensor.sample_direction(it, sample, active)
        _, weight, uv, visible = self._perspective.project(it.p)
        in_view = visible & dr.all((uv >= 0.0) & (uv <= 1.0))
        pixels = math.prod(self._sensor.film().crop_size())
        return ds, mi.Spectrum(dr.select(active & in_view, weight / pixels, 0.0))


@dataclass(frozen=True)
class ProjectiveBoundary:
    """Silhouettes, sampled by a projective integrator of Mitsuba.

    Attributes
    ----------
    sensor : mi.Sensor
    film : Film
        Of the sensor.
    term : {"sppp", "sppi"}
        Primary silhouettes, which the camera sees, or indirect ones, of shadows and reflections.
    unique_edges : UniqueEdges or None
        For indirect silhouettes, the mesh edges that count among coincident ones.
    """

    sensor: Any
    film: Film
    term: Literal["sppp", "sppi"]
    unique_edges: UniqueEdges | None = None

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """Sample silhouettes; see :class:`mitsuba_boundaries.terms.BoundarySampler`.

        `integrator` is the projective integrator. It takes the same samples in its own
        `render_backward` with this seed.
        """
        if not scene.silhouette_shapes():
            return None
        sensor = self.sensor
        with dr.suspend_grad():
            if self.term == "sppp":
                integrator.proj_detail.init_primarily_visible_silhouette(scene, sensor)
                render = integrator.render_primarily_visible_silhouette
            else:
                sensor = _OffCentreSensor(sensor) if is_off_centre(sensor) else sensor
                integrator.proj_detail.init_indirect_silhouette(scene, sensor, GUIDING_SEED_MASK ^ seed)
                render = integrator.render_indirect_silhouette
            sampler, spp = integrator.prepare(
                self.sensor, SEED_MASKS[self.term] ^ seed, samples, integrator.aov_names()
            )
        emitters = hittable_proxy_emitters() if self.term == "sppi" else nullcontext()
        with emitters, self._filtered(integrator), capture_splats() as splats:
            # With 1 sample per pixel: the number would be compiled into kernels. The values are divided by it below.
            render(scene, sensor, sampler, 1)
        if not splats:
            return None
        (splat,) = splats
        value = to_rgb(splat["value"], splat["wavelengths"], active=splat["active"])
        value = dr.select(splat["active"], value, 0.0) / dr.opaque(mi.Float, spp * self.film.border_oversampling)
        return value, dr.detach(splat["pos"]) / mi.Point2f(*map(float, self.film.size))

    @contextmanager
    def _filtered(self, integrator: Any) -> Iterator[None]:
        """Make the integrator skip redundant coincident edges, and edges that touch another surface.

        An edge that lies in another surface, as where two boxes end in one plane, casts no shadow on it. Rounding puts
        the edge beside that surface, nearer than any other occluder is.
        """
        if self.term != "sppi":
            yield
            return
        original, unique_edges = integrator.sample_importance, self.unique_edges

        def sample_importance(scene: Any, sensor: Any, silhouette: Any, *arguments: Any) -> Any:
            *leading, active = arguments
            if unique_edges is not None:
                active = active & unique_edges.is_representative(silhouette)  # not in place: it is the integrator's
            reverse = mi.SilhouetteSample3f(silhouette)
            reverse.d = -silhouette.d
            ray = reverse.spawn_ray()
            ray.maxt = CONTACT_EPSILONS * ray_epsilon(silhouette.p)
            return original(scene, sensor, silhouette, *leading, active & ~scene.ray_test(ray, active=active))

        integrator.sample_importance = sample_importance
        try:
            yield
        finally:
            del integrator.sample_importance

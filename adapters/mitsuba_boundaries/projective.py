"""The boundary term by Mitsuba's projective sampling of silhouettes.

The samples are taken before they reach the film, and sensors with an off-centre principal point are repaired.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Final, Literal

import drjit as dr
import mitsuba as mi

from mitsuba_boundaries.geometry.coincident_edges import UniqueEdges
from mitsuba_boundaries.integrator_view import IntegratorView
from mitsuba_boundaries.plugins.proxy_emitter import hittable_proxy_emitters
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.sensing.film_samples import to_rgb
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
class _SilhouetteShapes:
    """Some of a scene's silhouette shapes, where Mitsuba asks a scene for all of them."""

    shapes: list[Any]

    def silhouette_shapes(self) -> list[Any]:
        return self.shapes


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
    excluded : collection of mi.Shape
        For primary silhouettes, the shapes that are not sampled.
    """

    sensor: Any
    film: Film
    term: Literal["sppp", "sppi"]
    unique_edges: UniqueEdges | None = None
    excluded: Collection[Any] = ()

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """Sample silhouettes; see :class:`mitsuba_boundaries.terms.BoundarySampler`.

        `integrator` is the projective integrator. It takes the same samples in its own
        `render_backward` with this seed, if it samples the same shapes.
        """
        silhouettes = [shape for shape in scene.silhouette_shapes() if shape not in self.excluded]
        if not silhouettes:
            return None
        with dr.suspend_grad():
            sampler, spp = integrator.prepare(
                self.sensor, SEED_MASKS[self.term] ^ seed, samples, integrator.aov_names()
            )
        if self.term == "sppp":
            value, wavelengths, uv, active = self._sample_primary(scene, integrator, silhouettes, sampler)
        else:
            with hittable_proxy_emitters():
                value, wavelengths, uv, active = self._sample_indirect(scene, integrator, sampler, seed)
        value = dr.select(active, to_rgb(value, wavelengths, active=active), 0.0)
        # An opaque number, because a literal would be compiled into kernels.
        value /= dr.opaque(mi.Float, spp * self.film.border_oversampling)
        return value, dr.detach(uv) / mi.Point2f(*map(float, self.film.size))

    def _sample_primary(self, scene: Any, integrator: Any, silhouettes: list[Any], sampler: Any) -> tuple[Any, ...]:
        """Sample visible silhouettes, as Mitsuba's `render_primarily_visible_silhouette` does."""
        sensor, shapes = self.sensor, _SilhouetteShapes(silhouettes)
        detail = type(integrator.proj_detail)(integrator)  # it keeps the distribution of one call
        with dr.suspend_grad():
            detail.init_primarily_visible_silhouette(shapes, sensor)
            position = sensor.world_transform() @ mi.Point3f(0.0)
            silhouette = detail.sample_primarily_visible_silhouette(shapes, position, sampler.next_2d(), True)  # noqa: FBT003  # as Mitsuba does
            active = silhouette.is_valid() & (silhouette.pdf > 0.0)
            jacobian = detail.sensor_jacobian(sensor, silhouette)
            difference, wavelengths = detail.eval_primary_silhouette_radiance_difference(
                scene, sampler, silhouette, sensor, active=active
            )
            active &= dr.any(difference != 0.0)
            it = dr.zeros(mi.Interaction3f)
            it.p = silhouette.p
            ds, _ = sensor.sample_direction(it, mi.Point2f(0.0))
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.prim_index, si.uv = silhouette.p, silhouette.prim_index, silhouette.uv
        motion = dr.dot(silhouette.shape.differential_motion(dr.detach(si), active), silhouette.n)
        return difference * motion * dr.rcp(silhouette.pdf) * jacobian, wavelengths, ds.uv, active

    def _sample_indirect(self, scene: Any, integrator: Any, sampler: Any, seed: int) -> tuple[Any, ...]:
        """Sample indirect silhouettes, as Mitsuba's `render_indirect_silhouette` does."""
        sensor = _OffCentreSensor(self.sensor) if is_off_centre(self.sensor) else self.sensor
        filtered = IntegratorView(integrator, sample_importance=self._filtered_importance(integrator))
        detail = type(integrator.proj_detail)(filtered)  # it keeps the distribution of one call
        with dr.suspend_grad():
            detail.init_indirect_silhouette(scene, sensor, GUIDING_SEED_MASK ^ seed)
        sample, weight = detail.guiding_distr.sample(sampler)
        value, wavelengths, uv = detail.eval_indirect_integrand(scene, sensor, sample, sampler, preprocess=False)
        active = dr.any(value != 0.0)
        return value * weight, wavelengths, uv, active

    def _filtered_importance(self, integrator: Any) -> Callable[..., Any]:
        """Return an integrator's `sample_importance` without redundant coincident edges, and edges on other surfaces.

        An edge that lies in another surface, as where two boxes end in one plane, casts no shadow on it. Rounding puts
        the edge beside that surface, nearer than any other occluder is.
        """
        unique_edges = self.unique_edges
        vertex_positions = None if unique_edges is None else unique_edges.vertex_positions()

        def sample_importance(scene: Any, sensor: Any, silhouette: Any, *arguments: Any) -> Any:
            *leading, active = arguments
            if unique_edges is not None:
                active = active & unique_edges.is_representative(
                    silhouette, vertex_positions
                )  # not in place: the integrator's
            reverse = mi.SilhouetteSample3f(silhouette)
            reverse.d = -silhouette.d
            ray = reverse.spawn_ray()
            ray.maxt = CONTACT_EPSILONS * ray_epsilon(silhouette.p)
            active = active & ~scene.ray_test(ray, active=active)
            return integrator.sample_importance(scene, sensor, silhouette, *leading, active)

        return sample_importance

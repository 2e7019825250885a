"""The gradient of an image as the sum of its interior term and all of its boundary terms."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.edge_sampling import EdgeBoundary
from mitsuba_boundaries.geometry.coincident_edges import UniqueEdges
from mitsuba_boundaries.intersections import IntersectionBoundary
from mitsuba_boundaries.projective import ProjectiveBoundary
from mitsuba_boundaries.received_shadows import ReceivedShadowBoundary
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.terms import BoundarySampler, BoundaryTerm, GradientTerm, InteriorTerm

__all__ = ["ImageGradient"]

DIRECT_DEPTH: Final = 2  # `max_depth` of direct-light integrators, which have no such attribute
UNLIMITED_DEPTH: Final = 2**31  # `max_depth` of integrators without a limit is at least this


class ImageGradient:
    """The gradient of a sensor's image with respect to the entries of a scene that have gradients enabled.

    The edges of creased meshes and flat shapes, intersection curves and shadows on moving shapes have terms other than
    Mitsuba's, if the integrator is projective and the camera a perspective one.

    Parameters
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    shapes : iterable of mi.Shape
        The shapes that may move. Their creases are those that they have now.

    Attributes
    ----------
    edged_shapes : list of mi.Shape
        The shapes whose visible edges are sampled by :mod:`mitsuba_boundaries.edge_sampling`.
    """

    def __init__(self, scene: Any, sensor: Any, shapes: Iterable[Any]) -> None:
        shapes = list(shapes)
        self._scene, self._sensor = scene, sensor
        self._film = Film(sensor.film())
        self._edges = EdgeBoundary.from_scene(scene, sensor, shapes)
        self._intersections = IntersectionBoundary.from_scene(scene, sensor, shapes)
        self._received_shadows = ReceivedShadowBoundary.from_scene(scene, sensor, shapes)
        self._unique_edges = UniqueEdges.from_shapes(shapes)
        self.edged_shapes: list[Any] = [] if self._edges is None else self._edges.shapes

    def vjp(
        self, integrator: Any, cotangent: Float32Array, *, seed: int, spp: int = 0, excluded: Collection[str] = ()
    ) -> None:
        """Propagate a cotangent of the image to the entries.

        Parameters
        ----------
        integrator : mi.Integrator
            Boundary terms are added to those of projective integrators only.
        cotangent : array, shape (H, W, C)
        seed : int
        spp : int
            Samples per pixel of each term; 0 for those of the integrator, or else of the sensor's sampler. Terms that
            the integrator turns off by 0 stay off.
        excluded : collection of {"sppc", "sppp", "sppi"}
            Further terms to turn off.
        """
        # Isolated, so that no gradient flows on to other variables before all terms have arrived at the entries:
        # Mitsuba propagates some of them one after the other.
        with dr.isolate_grad():
            for term in self._terms(integrator, spp, excluded):
                term.vjp(cotangent, seed)

    def jvp(self, integrator: Any, *, seed: int, spp: int = 0, excluded: Collection[str] = ()) -> Float32Array:
        """Return the derivative of the image, shape (H, W, C), along the gradients that are set on the entries.

        The arguments are those of :meth:`vjp`, which is its adjoint.
        """
        width, height = self._film.size
        total: Float32Array = np.zeros((height, width, self._film.channels), np.float32)
        for term in self._terms(integrator, spp, excluded):
            total = total + term.jvp(seed)
        return total

    def _terms(self, integrator: Any, spp: int, excluded: Collection[str]) -> list[GradientTerm]:
        """Return the terms for the shapes that have gradients enabled."""
        sppc, sppp, sppi = (
            0 if name in excluded else self._sample_count(integrator, name, spp) for name in ("sppc", "sppp", "sppi")
        )
        moving = self._scene.silhouette_shapes()
        edges = self._edges if any(shape in self.edged_shapes for shape in moving) else None
        primary = [boundary for boundary in (self._intersections, edges) if boundary is not None and moving]
        boundaries: list[tuple[BoundarySampler, Any, int]] = []
        if primary and sppp:
            radiance = _radiance_integrator(integrator)
            boundaries = [(boundary, radiance, sppp) for boundary in primary]
        boundaries += [
            (ProjectiveBoundary(self._sensor, self._film, "sppp", excluded=self.edged_shapes), integrator, sppp),
            (ProjectiveBoundary(self._sensor, self._film, "sppi", self._unique_edges), integrator, sppi),
        ]
        if moving:
            boundaries += [(shadows, integrator, sppi) for shadows in self._received_shadows]
        terms: list[GradientTerm] = [
            BoundaryTerm(sampler, self._scene, self._film, integrator, samples)
            for sampler, integrator, samples in boundaries
            if samples
        ]
        if "sppc" not in excluded and getattr(integrator, "sppc", None) != 0:
            terms.append(InteriorTerm(self._scene, self._sensor, self._film, integrator, sppc or spp))
        return terms

    def _sample_count(self, integrator: Any, name: str, spp: int) -> int:
        """Return the samples per pixel of the term with this count; 0 if the integrator has no such term."""
        if not hasattr(integrator, name):
            return 0
        return int(integrator.override_spp(getattr(integrator, name), spp, self._sensor.sampler().sample_count()))


def _radiance_integrator(integrator: Any) -> Any:
    """Return a path tracer with the depth of the gradient's integrator."""
    depth = getattr(integrator, "max_depth", DIRECT_DEPTH)
    return mi.load_dict(
        {
            "type": "path",
            "max_depth": depth if 0 <= depth < UNLIMITED_DEPTH else -1,
            "hide_emitters": bool(getattr(integrator, "hide_emitters", False)),
        }
    )

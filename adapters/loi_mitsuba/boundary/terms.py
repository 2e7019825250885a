"""What carries parts of the gradient of a scene between its image and its entries: shading, and jumps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_mitsuba.boundary.area_jacobian import clamped_area_jacobian
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.scene.binding import as_host
from loi_mitsuba.scene.settings import PARTS
from loi_mitsuba.sensing.film import Film
from loi_mitsuba.sensing.film_samples import backpropagate, radiance_samples

__all__ = ["BoundarySampler", "BoundaryTerm", "InteriorTerm"]


class BoundarySampler(Protocol):
    """Samples points of discontinuities in the image, with the velocity of these points."""

    def sample(self, scene: Any, integrator: Any, samples: int, seed: int) -> tuple[Any, Any] | None:
        """Sample a boundary.

        Parameters
        ----------
        scene : mi.Scene
        integrator : mi.Integrator
            Measures the radiance on both sides of the boundary.
        samples : int
            Per pixel of the image.
        seed : int

        Returns
        -------
        tuple of (mi.Color3f, mi.Point2f), or None
            The values are zero, and their derivatives the radiance difference times the normal velocity of the
            boundary, divided by the sample density. The positions are on the film, 0 to 1 on both axes. None if there
            is no boundary.
        """


@dataclass(frozen=True)
class InteriorTerm:
    """What an integrator of Mitsuba has of the gradient, but for silhouettes.

    Attributes
    ----------
    scene, sensor, integrator : mi.Scene, mi.Sensor, mi.Integrator
    entries : mi.SceneParameters
        What the scene can be set by, some of it with a gradient.
    film : Film
        Of the camera.
    samples : int
        Per pixel.
    """

    scene: Any
    entries: Any
    sensor: Any
    film: Film
    integrator: Any
    samples: int

    def vjp(self, cotangent: Float32Array, seed: int) -> None:
        """Carry a cotangent of the image, shape (H, W, C), back to the entries."""
        if self._by_film:
            backpropagate(*self._samples(seed, dr.ADMode.Backward), self.film, cotangent)
            return
        with self._alone(), clamped_area_jacobian(self.integrator):
            try:
                self.integrator.render_backward(
                    self.scene, self.entries, mi.TensorXf(cotangent), self.sensor, seed, self.samples
                )
            except RuntimeError as error:
                if "does not depend on the input" not in str(error):
                    raise  # an image in which none of the entries is to be found, as one of depths, has the gradient 0

    def jvp(self, seed: int, seed_grad: int) -> Float32Array:
        """How the image changes with the entries: shape (H, W, C)."""
        if self._by_film:
            value, place = self._samples(seed_grad, dr.ADMode.Forward)
            change = dr.forward_to(value) if dr.grad_enabled(value) else mi.Color3f(0.0)
            with dr.suspend_grad():
                return self.film.mean(change, place)
        with self._alone(), clamped_area_jacobian(self.integrator):
            image = mi.render(
                self.scene,
                self.entries,
                self.sensor,
                self.integrator,
                seed=seed,
                seed_grad=seed_grad,
                spp_grad=self.samples,
            )
            return as_host(dr.forward_to(image), image.shape)

    @property
    def _by_film(self) -> bool:
        """Whether the integrator differentiates through the film."""
        special = mi.has_flag(self.sensor.film().flags(), mi.FilmFlags.Special)
        return not special and not getattr(self.integrator, "radiative_backprop", True)

    def _samples(self, seed: int, mode: Any) -> tuple[Any, Any]:
        with clamped_area_jacobian(self.integrator):
            return radiance_samples(self.integrator, self.scene, self.sensor, self.samples, seed, mode)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """The integrator has no silhouettes meanwhile."""
        before = {part: getattr(self.integrator, part) for part in PARTS[1:] if hasattr(self.integrator, part)}
        for part in before:
            setattr(self.integrator, part, 0)
        try:
            yield
        finally:
            for part, count in before.items():
                setattr(self.integrator, part, count)


@dataclass(frozen=True)
class BoundaryTerm:
    """What jumps of brightness have of it, of one kind.

    Attributes
    ----------
    drawn : Silhouettes, Edges, Crossings or Received
    scene : mi.Scene
    film : Film
        Of the camera.
    radiance : mi.Integrator
        Says how bright it is where a ray goes; of silhouettes, what draws them.
    samples : int
        Per pixel of the image.
    """

    drawn: BoundarySampler
    scene: Any
    film: Film
    radiance: Any
    samples: int

    def vjp(self, cotangent: Float32Array, seed: int) -> None:
        """Carry a cotangent of the image, shape (H, W, C), back to the shapes."""
        found = self.drawn.sample(self.scene, self.radiance, self.samples, seed)
        if found is not None:
            value, place = found
            weighted = value * self.film.gather(cotangent, place)
            if dr.grad_enabled(weighted):  # or else Dr.Jit knows that none jumps, as at shadows under a point light
                # Their sum, which Dr.Jit would evaluate, would trace all rays twice.
                dr.backward(weighted, dr.ADFlag.ClearInterior)

    def jvp(self, seed: int, seed_grad: int) -> Float32Array:  # noqa: ARG002  # there is no image to draw
        """How the image changes with the shapes, which have a gradient: shape (H, W, C)."""
        found = self.drawn.sample(self.scene, self.radiance, self.samples, seed_grad)
        if found is None:
            width, height = self.film.size
            return np.zeros((height, width, self.film.channels), dtype=np.float32)
        value, place = found
        change = mi.Color3f(dr.forward_to(value)) if dr.grad_enabled(value) else mi.Color3f(0.0)
        with dr.suspend_grad():
            return self.film.splat(change, place)

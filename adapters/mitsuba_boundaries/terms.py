"""The interior and boundary terms of a gradient, each with a vjp and a jvp."""

from __future__ import annotations

from dataclasses import dataclass
from types import FunctionType
from typing import Any, Final, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from mitsuba_boundaries.area_jacobian import corrected_sample
from mitsuba_boundaries.drjit.arrays import Float32Array
from mitsuba_boundaries.integrator_view import IntegratorView, is_from_mitsuba
from mitsuba_boundaries.sensing.film import Film
from mitsuba_boundaries.sensing.film_samples import backpropagate, radiance_samples

__all__ = ["BoundarySampler", "BoundaryTerm", "GradientTerm", "InteriorTerm"]

SILHOUETTE_COUNTS: Final = ("sppp", "sppi")  # attributes of Mitsuba's projective integrators


class GradientTerm(Protocol):
    """A term of the gradient of a scene's image with respect to the scene's entries that have gradients enabled."""

    def vjp(self, cotangent: Float32Array, seed: int) -> None:
        """Propagate a cotangent of the image, shape (H, W, C), to the entries."""

    def jvp(self, seed: int) -> Float32Array:
        """Return the derivative of the image, shape (H, W, C), along the gradients set on the entries.

        The entries keep these gradients, for the next term. The interior term may not keep them.
        """


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
    """The derivative of the radiance between discontinuities, by an integrator of Mitsuba.

    Attributes
    ----------
    scene : mi.Scene
    sensor : mi.Sensor
    film : Film
        Of the sensor.
    integrator : mi.Integrator
    samples : int
        Per pixel.
    """

    scene: Any
    sensor: Any
    film: Film
    integrator: Any
    samples: int

    def vjp(self, cotangent: Float32Array, seed: int) -> None:
        """Propagate a cotangent of the image; see :class:`GradientTerm`."""
        if self._bypasses_film:
            backpropagate(*self._radiance_samples(seed, dr.ADMode.Backward), self.film, cotangent)
            return
        try:
            self._call("render_backward", self.scene, {}, mi.TensorXf(cotangent), self.sensor, seed, self.samples)
        except RuntimeError as error:
            if "does not depend on the input" not in str(error):
                raise  # else the gradient is 0, as of an image of depths with respect to colours

    def jvp(self, seed: int) -> Float32Array:
        """Return the derivative of the image; see :class:`GradientTerm`."""
        if self._bypasses_film:
            value, uv = self._radiance_samples(seed, dr.ADMode.Forward)
            change = dr.forward_to(value, flags=dr.ADFlag.ClearEdges) if dr.grad_enabled(value) else mi.Color3f(0.0)
            with dr.suspend_grad():
                return self.film.reconstruct(change, uv)
        change = self._call("render_forward", self.scene, {}, self.sensor, seed, self.samples)
        return np.array(change, dtype=np.float32, order="C")

    @property
    def _view(self) -> Any:
        """The integrator without samples of silhouettes, and with a corrected area Jacobian."""
        counts = dict.fromkeys(SILHOUETTE_COUNTS, 0)
        return IntegratorView(self.integrator, sample=corrected_sample(self.integrator, self.scene), **counts)

    def _call(self, name: str, *arguments: Any) -> Any:
        """Call the method of Mitsuba that differentiates the interior: of projective integrators, not of a subclass."""
        bases = (base for base in type(self.integrator).__mro__ if is_from_mitsuba(base))
        projective = next((base for base in bases if base.__name__ == "PSIntegrator"), None)
        method = getattr(projective or type(self.integrator), name)
        takes_views = isinstance(method, FunctionType) and is_from_mitsuba(method)
        return method(self._view if takes_views else self.integrator, *arguments)

    @property
    def _bypasses_film(self) -> bool:
        """Whether samples are taken before the film: for integrators that would differentiate through it."""
        is_special = mi.has_flag(self.sensor.film().flags(), mi.FilmFlags.Special)
        return not is_special and not getattr(self.integrator, "radiative_backprop", True)

    def _radiance_samples(self, seed: int, mode: Any) -> tuple[Any, Any]:
        return radiance_samples(self._view, self.scene, self.sensor, self.samples, seed, mode)


@dataclass(frozen=True)
class BoundaryTerm:
    """The derivative of an image due to the motion of one kind of discontinuity.

    Attributes
    ----------
    sampler : BoundarySampler
    scene : mi.Scene
    film : Film
        Of the sensor.
    integrator : mi.Integrator
        See :meth:`BoundarySampler.sample`.
    samples : int
        Per pixel of the image.
    """

    sampler: BoundarySampler
    scene: Any
    film: Film
    integrator: Any
    samples: int

    def vjp(self, cotangent: Float32Array, seed: int) -> None:
        """Propagate a cotangent of the image; see :class:`GradientTerm`."""
        sample = self.sampler.sample(self.scene, self.integrator, self.samples, seed)
        if sample is not None:
            value, uv = sample
            weighted = value * self.film.gather(cotangent, uv)
            if dr.grad_enabled(weighted):  # False if Dr.Jit knows the difference to be 0
                # Not of the sum, which Dr.Jit would evaluate first, tracing all rays twice.
                dr.backward(weighted, dr.ADFlag.ClearInterior)

    def jvp(self, seed: int) -> Float32Array:
        """Return the derivative of the image; see :class:`GradientTerm`."""
        sample = self.sampler.sample(self.scene, self.integrator, self.samples, seed)
        if sample is None:
            width, height = self.film.size
            return np.zeros((height, width, self.film.channels), dtype=np.float32)
        value, uv = sample
        change = (
            mi.Color3f(dr.forward_to(value, flags=dr.ADFlag.ClearEdges)) if dr.grad_enabled(value) else mi.Color3f(0.0)
        )
        with dr.suspend_grad():
            return self.film.splat(change, uv)

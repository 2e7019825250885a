"""Projective integrators of Mitsuba with all boundary terms, for ``mi.render`` and ``mi.load_dict``."""

from __future__ import annotations

from typing import Any, Final

import mitsuba as mi
import numpy as np

from mitsuba_boundaries.gradient import ImageGradient

__all__ = ["INTEGRATORS", "register_integrators"]

INTEGRATORS: Final = {"direct_boundaries": "direct_projective", "prb_boundaries": "prb_projective"}
"""The names of the integrators, and of those that they extend."""

CLASSES: Final = {"direct_projective": "DirectProjectiveIntegrator", "prb_projective": "PathProjectiveIntegrator"}


def register_integrators(*_: Any) -> None:
    """Register the integrators with Mitsuba's current variant, if it has gradients."""
    if mi.variant() is None or mi.variant().startswith("scalar"):
        return
    for name, extended in INTEGRATORS.items():
        mi.register_integrator(name, lambda props, extended=extended: _integrator_class(extended)(props))


def _integrator_class(extended: str) -> Any:
    """Return the class of an integrator. Its base is the variant's own, and Mitsuba replaces it with each variant."""
    base: Any = getattr(getattr(mi.ad.integrators, extended), CLASSES[extended])

    class BoundaryIntegrator(base):  # type: ignore[misc]
        """The integrator `extended`, whose gradient has all boundary terms. Its image is the same."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            if self.guiding == "grid" and self.sppi != 0:
                msg = (
                    '`guiding` is "grid", with which Mitsuba samples hardly any edges of shadows; their gradient is '
                    'nearly 0; use "none" or "octree"'
                )
                raise ValueError(msg)

        def render_backward(
            self,
            scene: Any,
            params: Any,  # noqa: ARG002  # the scene has its entries
            grad_in: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> None:
            gradient = _image_gradient(scene, sensor)
            gradient.vjp(self, np.array(grad_in, dtype=np.float32), seed=_whole(seed), spp=spp)

        def render_forward(
            self,
            scene: Any,
            params: Any,  # noqa: ARG002  # the scene has its entries
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> Any:
            return mi.TensorXf(_image_gradient(scene, sensor).jvp(self, seed=_whole(seed), spp=spp))

    return BoundaryIntegrator


def _image_gradient(scene: Any, sensor: Any) -> ImageGradient:
    """Return the gradient with respect to the shapes that have gradients enabled now, with the creases of now.

    The integrator keeps nothing between calls, because vertices may move by themselves; only the connectivity of meshes
    is kept. For a mesh of 82,000 triangles this takes half a second of one core.
    """
    sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
    return ImageGradient(scene, sensor, scene.silhouette_shapes())


def _whole(seed: Any) -> int:
    """Return a seed, which may be an mi.UInt32, as a whole number."""
    return int(np.array(seed).reshape(-1)[0])

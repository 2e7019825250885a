"""Draws of the gradient at one point of a fit, under any settings."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from loi_core.effects import Draws
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.settings import Settings
from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["PILOT_SEED_OFFSET", "GradientProbe"]

PILOT_SEED_OFFSET: Final = 2**63  # beyond all seeds of a fit: steps with the noise of a draw would seem to confirm it


@dataclass(frozen=True)
class GradientProbe:
    """A point of a fit, and the gradient of the loss with respect to the image there.

    Attributes
    ----------
    renderer : MitsubaRenderer
        Renderer of the scene, under any plan.
    params : dict of arrays
        Values of all parameters.
    cotangent : array, shape (H, W, C)
        Gradient of the loss with respect to the image.
    names : tuple of str
        Parameters whose gradient is drawn.
    seed : int
        First seed; a fit with the same seeds has other noise.
    """

    renderer: MitsubaRenderer
    params: Mapping[str, Any]
    cotangent: Any
    names: tuple[str, ...]
    seed: int = 0

    def gradients(self, settings: Settings, seeds: Sequence[int]) -> Draws:
        """Draw the gradient under these settings once for each seed.

        The time of the draws is the shortest, because the first may include the compilation of kernels.
        """
        renderer = self.renderer.with_integrator(
            settings.load(), spp_grad=None if settings.projective else settings.sppc, wrt=self.names
        )
        gradients, times = [], []
        for seed in seeds:
            begin = time.perf_counter()
            gradient = renderer.vjp(self.params, self.cotangent, seed=PILOT_SEED_OFFSET + seed)
            times.append(time.perf_counter() - begin)
            gradients.append({name: gradient[name] for name in self.names})
        return Draws.of(gradients, min(times))

    def image(self, settings: Settings, seed: int) -> Float32Array:
        """Render the image under these settings."""
        return self.renderer.with_integrator(settings.load()).render(self.params, seed=PILOT_SEED_OFFSET + seed)

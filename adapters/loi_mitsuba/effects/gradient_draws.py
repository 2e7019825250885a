"""Draws of the gradient at one place of a fit, under any settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from loi_core.effects import Draws
from loi_mitsuba.drjit.arrays import Float32Array
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.settings import Settings

__all__ = ["APART", "Probe"]

APART: Final = 2**63  # beyond all seeds of a fit: a step with the noise of a draw would seem to agree with it


@dataclass(frozen=True)
class Probe:
    """Where the gradient is asked for.

    Attributes
    ----------
    renderer : MitsubaRenderer
        Any of those that fraction the scene.
    params : dict of arrays
        The parameters.
    cotangent : array, shape (H, W, C)
        The gradient of the loss by the image there.
    names : tuple of str
        The parameters that are optimised.
    seed : int
        First of the seeds that are used; a fit at the same seeds has other noise.
    """

    renderer: MitsubaRenderer
    params: Mapping[str, Any]
    cotangent: Any
    names: tuple[str, ...]
    seed: int = 0

    def gradients(self, settings: Settings, seeds: Sequence[int]) -> Draws:
        """Draws of the gradient under these settings, of each parameter alone."""
        made = self.renderer.with_integrator(
            settings.load(), spp_grad=None if settings.projective else settings.sppc, wrt=self.names
        )
        return _draw(lambda seed: made.vjp(self.params, self.cotangent, seed=APART + seed), self.names, seeds)

    def image(self, settings: Settings, seed: int) -> Float32Array:
        """The image under these settings."""
        return self.renderer.with_integrator(settings.load()).render(self.params, seed=APART + seed)


def _draw(function: Callable[[int], Mapping[str, Any]], names: Sequence[str], seeds: Sequence[int]) -> Draws:
    """One draw of a gradient for each seed, and the time of the fastest: the first may compile."""
    drawn, times = [], []
    for seed in seeds:
        begin = time.perf_counter()
        pulled = function(seed)
        times.append(time.perf_counter() - begin)
        drawn.append({name: pulled[name] for name in names})
    return Draws.of(drawn, min(times))

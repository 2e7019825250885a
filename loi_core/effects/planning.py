"""What a renderer has that plans which effects it simulates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol, runtime_checkable

from loi_core.effects.model import EffectPlan
from loi_core.renderers.contract import Parameters, Renderer
from loi_core.support.arrays import Array

__all__ = ["PlanningRenderer"]


@runtime_checkable
class PlanningRenderer(Renderer, Protocol):
    """A renderer that simulates only the effects that a loss calls for.

    Scenes whose renderer has these methods are planned before their fit, and explained by ``loi fit --explain``. One
    that plans anew as a fit goes on is a :class:`~loi_core.renderers.contract.SteppedRenderer` as well.
    """

    @property
    def plan(self) -> EffectPlan:
        """What is simulated now."""

    def begin(self, params: Parameters, cotangent: Array, *, optimise: Iterable[str], seed: int = 0) -> EffectPlan:
        """Plan a fit that starts at `params`, where the loss has the gradient `cotangent` by the image.

        Only the gradients of the parameters named in `optimise` matter. Those that the plan holds have a gradient of 0
        until it lets them go.
        """

    def effect_images(self, params: Parameters, cotangent: Array, *, seed: int = 0) -> Mapping[str, Any]:
        """By effect, how its part of the image changes along the descent of the loss: arrays (H, W, C)."""

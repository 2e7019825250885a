"""The interface of renderers that plan which effects of light transport they simulate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from loi_core.effects.model import EffectPlan
from loi_core.support.arrays import Array

__all__ = ["EffectPlanner"]


class EffectPlanner(Protocol):
    """Plans the effects that a renderer simulates, from the effects that a loss depends on.

    A renderer offers it as ``capabilities.planner``. Scene files call :meth:`begin` before a fit, and
    ``loi fit --explain`` prints the plan.
    """

    @property
    def plan(self) -> EffectPlan:
        """The current plan."""

    def begin(self, params: Any, cotangent: Array, *, optimise: Iterable[str], seed: int = 0) -> EffectPlan:
        """Plan a fit that starts at `params`, where the loss has the gradient `cotangent` with respect to the image.

        Only the gradients of the parameters named in `optimise` count. Parameters that the plan freezes have gradient
        0 until it releases them.
        """

    def effect_images(self, params: Any, cotangent: Array, *, seed: int = 0) -> Mapping[str, Any]:
        """Return, by effect, how its part of the image changes along the descent of the loss: arrays (H, W, C)."""

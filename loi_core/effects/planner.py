"""The interface of renderers that plan which effects of light transport they simulate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from loi_core.effects.model import EffectPlan
from loi_core.support.arrays import Array

__all__ = ["EffectPlanner"]


class EffectPlanner(Protocol):
    """Plans the effects that a renderer simulates, from the effects that a loss depends on.

    A renderer offers it as ``capabilities.planner``. The plan of a renderer never changes: ``capabilities.start`` and
    ``capabilities.revisit`` return renderers with other plans. ``loi fit --explain`` prints the plan.
    """

    @property
    def plan(self) -> EffectPlan:
        """The plan."""

    def effect_images(
        self, params: Any, cotangent: Array, *, optimise: Iterable[str], seed: int = 0
    ) -> Mapping[str, Any]:
        """Return, by effect, how its part of the image changes along the descent of the loss: arrays (H, W, C).

        Only the parameters named in `optimise` change.
        """

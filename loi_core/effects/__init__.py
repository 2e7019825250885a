"""Which effects of light transport a scene calls for: a model that knows no renderer."""

from loi_core.effects.allocation import allocate, whole_samples
from loi_core.effects.model import Capability, Choice, Effect, EffectPlan
from loi_core.effects.planning import PlanningRenderer
from loi_core.effects.statistics import Comparison, Draws, compare, total

__all__ = [
    "Capability",
    "Choice",
    "Comparison",
    "Draws",
    "Effect",
    "EffectPlan",
    "PlanningRenderer",
    "allocate",
    "compare",
    "total",
    "whole_samples",
]

"""Which effects of light transport a scene calls for: a model that knows no renderer."""

from loi_core.effects.allocation import allocate, whole_samples
from loi_core.effects.fractions import Sizes, largest_fraction, most_fraction, relative_variance, sizes_of
from loi_core.effects.frozen import Evidence, Frozen
from loi_core.effects.model import Capability, Choice, Effect, EffectPlan
from loi_core.effects.planner import EffectPlanner
from loi_core.effects.schedule import Schedule
from loi_core.effects.statistics import SURE, Comparison, Draws, compare, total

__all__ = [
    "SURE",
    "Capability",
    "Choice",
    "Comparison",
    "Draws",
    "Effect",
    "EffectPlan",
    "EffectPlanner",
    "Evidence",
    "Frozen",
    "Schedule",
    "Sizes",
    "allocate",
    "compare",
    "largest_fraction",
    "most_fraction",
    "relative_variance",
    "sizes_of",
    "total",
    "whole_samples",
]

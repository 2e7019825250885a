"""Effects of light transport that a scene requires, independent of any renderer."""

from loi_core.effects.allocation import allocate, power_of_two_samples
from loi_core.effects.fractions import (
    GradientNorms,
    fraction_bound,
    largest_fraction,
    relative_variance,
    significant_norms,
)
from loi_core.effects.frozen import Evidence, Frozen
from loi_core.effects.model import Capability, Choice, Effect, EffectPlan
from loi_core.effects.planner import EffectPlanner
from loi_core.effects.schedule import Schedule
from loi_core.effects.statistics import SIGNIFICANT_ERRORS, Comparison, Draws, compare, total

__all__ = [
    "SIGNIFICANT_ERRORS",
    "Capability",
    "Choice",
    "Comparison",
    "Draws",
    "Effect",
    "EffectPlan",
    "EffectPlanner",
    "Evidence",
    "Frozen",
    "GradientNorms",
    "Schedule",
    "allocate",
    "compare",
    "fraction_bound",
    "largest_fraction",
    "power_of_two_samples",
    "relative_variance",
    "significant_norms",
    "total",
]

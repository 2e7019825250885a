"""What accuracy costs in time, measured here: settings of the loss, the noise of a renderer, and which to choose."""

from loi_core.tradeoff.choice import HIDDEN, WITHIN, Recommendation, pareto_set, recommend
from loi_core.tradeoff.noise import Noise
from loi_core.tradeoff.rows import Row
from loi_core.tradeoff.run import Missing, Problem, Tradeoff, measure
from loi_core.tradeoff.settings import Setting, settings_of

__all__ = [
    "HIDDEN",
    "WITHIN",
    "Missing",
    "Noise",
    "Problem",
    "Recommendation",
    "Row",
    "Setting",
    "Tradeoff",
    "measure",
    "pareto_set",
    "recommend",
    "settings_of",
]

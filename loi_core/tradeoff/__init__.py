"""Measured cost of accuracy: settings of the loss, noise of a renderer, and a recommendation."""

from loi_core.tradeoff.choice import MAX_NOISE_FRACTION, TOLERANCE, Recommendation, pareto_set, recommend
from loi_core.tradeoff.noise import Noise
from loi_core.tradeoff.rows import Row
from loi_core.tradeoff.run import Missing, Problem, Tradeoff, measure
from loi_core.tradeoff.settings import Setting, settings_of

__all__ = [
    "MAX_NOISE_FRACTION",
    "TOLERANCE",
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

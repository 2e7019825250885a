"""Image objectives: the paper's loss and its baselines, all with ``value``, ``value_and_grad`` and ``terms``."""

from loi_core.objectives.base import ImageObjective, Objective
from loi_core.objectives.evaluation import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.objectives.loi import LOIObjective
from loi_core.objectives.loss import loi_loss
from loi_core.objectives.msssim import MSSSIM
from loi_core.objectives.pixel import PixelL2
from loi_core.objectives.pyramid import GaussianPyramid
from loi_core.pixels.bounds import RangeWarning
from loi_core.pixels.exposure import LinearExposure

__all__ = [
    "MSSSIM",
    "Evaluation",
    "GaussianPyramid",
    "ImageObjective",
    "LOIObjective",
    "LinearExposure",
    "Objective",
    "PixelL2",
    "PlaneComparison",
    "RangeWarning",
    "ReferencePlanes",
    "loi_loss",
]

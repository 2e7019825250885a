"""`loi`: locally orderless images as a loss for inverse rendering, on any array library and any renderer."""

from loi_core.cameras.posed_image import PosedImage
from loi_core.cameras.reading import read_posed_images
from loi_core.errors import FitDivergedError, FitError, LoiError, NonFiniteImageError
from loi_core.fitting.loop import FitInterruptedError, FitResult, FitStep, fit
from loi_core.fitting.optimiser import Optimiser
from loi_core.fitting.parameters import Free
from loi_core.fitting.schedule import FarToNear
from loi_core.fitting.verdict import Diagnosis
from loi_core.method.histograms import inner_images, isophotes, local_histograms
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import (
    MSSSIM,
    GaussianPyramid,
    ImageObjective,
    LOIObjective,
    Objective,
    PixelL2,
    loi_loss,
)
from loi_core.pixels.tone_curve import LogTone
from loi_core.plugins.registry import available_renderers, load_renderer
from loi_core.renderers.contract import Parameters, Pullback, Renderer, RendererCapabilities
from loi_core.scenes.target import Target, read_target

__version__ = "0.1.0"
"""The version of the library."""

__all__ = [
    "MSSSIM",
    "Diagnosis",
    "FarToNear",
    "FitDivergedError",
    "FitError",
    "FitInterruptedError",
    "FitResult",
    "FitStep",
    "Free",
    "GaussianPyramid",
    "ImageObjective",
    "LOIObjective",
    "LogTone",
    "LoiError",
    "NonFiniteImageError",
    "Objective",
    "Optimiser",
    "Parameters",
    "PixelL2",
    "PosedImage",
    "Pullback",
    "Renderer",
    "RendererCapabilities",
    "ScaleSpace",
    "Target",
    "__version__",
    "available_renderers",
    "fit",
    "inner_images",
    "isophotes",
    "load_renderer",
    "local_histograms",
    "loi_loss",
    "read_posed_images",
    "read_target",
]

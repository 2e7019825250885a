"""How a fit is done: the published protocol, and ours, whose rates are in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from loi_core import ScaleSpace

__all__ = ["FINISH_RATE", "LABELS", "PAPER_SCALES", "PROTOCOLS", "PUBLISHED", "RATES", "Method", "Setting", "ours"]

Method = Literal["rgbxy", "rgbxy_finetune", "gaussian_pyramid", "ms_ssim", "lpips_alex", "pixel_l2", "loi"]

LABELS: Final[dict[Method, str]] = {
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "rgbxy": "RGBXY",
    "rgbxy_finetune": "RGBXY, finetune",
    "loi": "loi (ours)",
}
PAPER_SCALES: Final = ScaleSpace((0.0, 5.0), (1.0, 5.0, 15.0, 45.0), 1.0 / 32.0)


@dataclass(frozen=True)
class Setting:
    """One way to fit.

    Attributes
    ----------
    name : {"published", "ours"}
        The protocol. "published": Adam at 0.02 world units, radians or shares of 1, times 0.999 with every step, and
        the paper's scales. "ours": rates in pixels, which fall along a cosine, bounds, and the library's own scales
        and stages.
    method : str
        Which objective.
    rate : float
        Adam's, in units of the protocol.
    steps : int
        Of the fit; each renders one view, drawn at random.
    finish : float
        Share of the steps, at the end, that compare pixels; more for ours, if it settles before and has too many
        parameters to search for a start.
    grid : int
        Points along each side that RGBXY matches.
    """

    name: Literal["published", "ours"]
    method: Method
    rate: float
    steps: int = 1000
    finish: float = 0.0
    grid: int = 32


def _finish(method: Method) -> float:
    return 0.25 if method == "rgbxy_finetune" else 0.0


def ours(method: Method, rate: float) -> Setting:
    """The setting of our protocol at a rate in pixels."""
    return Setting("ours", method, rate, finish=0.5 if method == "loi" else _finish(method))


PUBLISHED: Final = {method: Setting("published", method, 0.02, finish=_finish(method)) for method in LABELS}

# Of the rate of our protocol, for what compares pixels at the end. On the search's start of Shape, Material and Env.
# map it is as good as a third of it in the mean, and better in Material, where pixels alone are the rival.
FINISH_RATE: Final = 2.0 / 3.0

# Pixels that the image moves by a step; those of the second table are the best of a search over these, for each method.
RATES: Final = (0.15, 0.5, 1.5)
CHOSEN: Final[dict[Method, float]] = {
    "pixel_l2": 0.5,
    "gaussian_pyramid": 0.5,
    "ms_ssim": 1.5,
    "lpips_alex": 0.5,
    "rgbxy": 0.5,
    "rgbxy_finetune": 0.5,
    "loi": 1.5,
}
PROTOCOLS: Final = {"published": PUBLISHED, "ours": {method: ours(method, CHOSEN[method]) for method in LABELS}}

"""How a fit is done: the published protocol, and one whose rates are searched for every method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from loi_core import ScaleSpace

__all__ = ["LABELS", "OUR_SCALES", "PAPER_SCALES", "PROTOCOLS", "PUBLISHED", "RATES", "Method", "Setting"]

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
OUR_SCALES: Final = ScaleSpace((1.0, 5.0, 15.0), (5.0, 15.0, 45.0), 1.0 / 8.0)


@dataclass(frozen=True)
class Setting:
    """One way to fit.

    Attributes
    ----------
    name : str
        Of the protocol.
    method : str
        Which objective.
    rate : float
        Adam's, in world units, radians and shares of 1.
    steps : int
        Of the fit; each renders one view, drawn at random.
    decay : {"step", "cosine"}
        Of the rate: 0.999 of it with every step, or to a thousandth of it.
    finish : float
        Share of the steps, at the end, that compare pixels.
    grid : int
        Points along each side that RGBXY matches.
    """

    name: str
    method: Method
    rate: float = 0.02
    steps: int = 1000
    decay: Literal["step", "cosine"] = "step"
    finish: float = 0.0
    grid: int = 32


def _finish(method: Method) -> float:
    return 0.25 if method == "rgbxy_finetune" else 0.0


PUBLISHED: Final = {method: Setting("published", method, finish=_finish(method)) for method in LABELS}

# Of each method and column the best of the search, which has a seed of its own.
RATES: Final = (0.005, 0.02, 0.08)


def searched(method: Method, rate: float) -> Setting:
    """The setting of the second protocol at a rate."""
    finish = 0.25 if method == "loi" else _finish(method)
    return Setting("ours", method, rate, decay="cosine", finish=finish)


PROTOCOLS: Final = {"published": PUBLISHED, "ours": {method: searched(method, 0.02) for method in LABELS}}

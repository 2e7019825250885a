"""Settings of a fit: the published protocol, and our protocol, whose rates are in pixels."""

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
    """Objective and optimiser settings of a fit. Their names and values identify stored runs.

    Attributes
    ----------
    name : {"published", "ours"}
        Protocol. "published": Adam at 0.02 world units, radians or fractions of 1, multiplied by 0.999 in every step,
        and the paper's scales. "ours": rates in pixels with a cosine decay, bounds, and the library's default scales
        and stages.
    method : str
        Objective.
    rate : float
        Learning rate of Adam, in units of the protocol.
    steps : int
        Number of steps; each renders one random view.
    finish : float
        Final fraction of the steps, which compares pixels. The LOI objective of our protocol hands over sooner if it
        settles, and if there are too many parameters to search for a start.
    grid : int
        Points that RGBXY matches along each side of the image.
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
    """Return the setting of our protocol at a rate in pixels."""
    return Setting("ours", method, rate, finish=0.5 if method == "loi" else _finish(method))


PUBLISHED: Final = {method: Setting("published", method, 0.02, finish=_finish(method)) for method in LABELS}

# Fraction of the rate for the final steps on pixels. From the start of the search in Shape, Material and Env. map, a
# fraction of 1/3 is as good on average; 2/3 is better in Material, where the strongest rival is pixel L2.
FINISH_RATE: Final = 2.0 / 3.0

# Pixels that the image moves per step: candidates of the search, and the best candidate of each method.
RATES: Final = (0.15, 0.5, 1.5)
BEST_RATES: Final[dict[Method, float]] = {
    "pixel_l2": 0.5,
    "gaussian_pyramid": 0.5,
    "ms_ssim": 1.5,
    "lpips_alex": 0.5,
    "rgbxy": 0.5,
    "rgbxy_finetune": 0.5,
    "loi": 1.5,
}
PROTOCOLS: Final = {"published": PUBLISHED, "ours": {method: ours(method, BEST_RATES[method]) for method in LABELS}}

"""How a fit is done: the published protocol, and ours, whose rates are in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from loi_core import ScaleSpace
from loi_core.pixels.colours import Colours

__all__ = [
    "FINISH_MOMENTUM",
    "FINISH_RATE",
    "FINISH_SAMPLES",
    "LABELS",
    "PAPER_SCALES",
    "PROTOCOLS",
    "RATES",
    "UNIT",
    "Method",
    "Setting",
    "many",
    "ours",
]

Method = Literal["pixel_l2", "gaussian_pyramid", "ms_ssim", "lpips_alex", "prdpt", "loi_prdpt", "loi"]

LABELS: Final[dict[Method, str]] = {
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "prdpt": "PRDPT",
    "loi_prdpt": "loi + PRDPT",
    "loi": "loi (ours)",
}
PAPER_SCALES: Final = ScaleSpace((1.0, 5.0), (1.0, 5.0, 15.0, 45.0), 0.125)
UNIT: Final = 256  # width of the image whose pixels a rate is in

# Wide scales see how bright an image is as well as where things are: light that a plan leaves out moves their minimum.
FINISH: Final = 0.25
FINISH_RATE: Final = 0.1
# Of a finish that is exact: how many times the samples its images have, and how much a step keeps of those before. With
# the 0.9 of Adam, so short a finish would end while it still swings.
FINISH_SAMPLES: Final = 8
FINISH_MOMENTUM: Final = 0.5


@dataclass(frozen=True)
class Setting:
    """One way to fit.

    Attributes
    ----------
    name : {"published", "ours"}
        The protocol. "published": Adam at 0.01 units of the scene, and the paper's scales. "ours": rates in pixels,
        which fall along a cosine, and the library's own scales and stages. Both have the same bounds.
    method : str
        Which objective; those with ``prdpt`` take their gradient from ten images at drawn parameters, and all others
        Mitsuba's, by a plan.
    rate : float
        Adam's, in units of the protocol.
    steps : int
        Of the fit.
    finish : float
        Share of the steps, at the end, that compare pixels, at :data:`FINISH_RATE` of the rate.
    exact : bool
        Whether images leave no light out and have more samples in these steps, which have less momentum.
    colours : {"channels", "differences"}
        What of the colours our loss compares.
    staged : bool
        Whether our loss begins with scales that reach far, as by default.
    sigma, final_sigma : float
        Of the blur over parameters, in units of the scene: held for half of the steps before those of the finish,
        which has the last one.
    """

    name: Literal["published", "ours"]
    method: Method
    rate: float
    steps: int = 100
    finish: float = 0.0
    exact: bool = False
    colours: Colours = "channels"
    staged: bool = True
    sigma: float = 0.5
    final_sigma: float = 0.01

    @property
    def blurred(self) -> bool:
        """Whether its gradient is that of images blurred over their parameters."""
        return self.method in ("prdpt", "loi_prdpt")

    @property
    def compares(self) -> str:
        """The objective."""
        return {"prdpt": "pixel_l2", "loi_prdpt": "loi"}.get(self.method, self.method)


def ours(method: Method, rate: float) -> Setting:
    """The setting of our protocol at a rate in pixels."""
    finish = FINISH if method in ("loi", "loi_prdpt") else 0.0
    return Setting("ours", method, rate, finish=finish, exact=method == "loi")


def many(setting: Setting) -> Setting:
    """The setting where many things move, each in the shadows of others.

    It takes longer. Our loss does not see shadows there, nor does it begin with an image so blurred that things which
    crowd are one. What it ends with is far more than an exact finish is about.
    """
    longer = replace(setting, steps=200, exact=False)
    return replace(longer, colours="differences", staged=False) if setting.compares == "loi" else longer


# Steps are not published; 400 are those of PRDPT's own example, and at this rate what the farthest start needs.
PUBLISHED: Final = {method: Setting("published", method, 0.01, steps=400, staged=False) for method in LABELS}

# Pixels that the image moves by a step; those of the second table are the best of a search over these, for each method.
RATES: Final = (1.0, 3.0, 9.0)
CHOSEN: Final = dict.fromkeys(LABELS, 3.0) | {"ms_ssim": 9.0}
PROTOCOLS: Final = {"ours": {method: ours(method, CHOSEN[method]) for method in LABELS}, "published": PUBLISHED}

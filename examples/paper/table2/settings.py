"""Settings of a fit: the published protocol, and our protocol, whose rates are in pixels."""

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
    "RATE_WIDTH",
    "Method",
    "Setting",
    "for_many_objects",
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
RATE_WIDTH: Final = 256  # pixels; settings state rates for an image of this width

# The final quarter of the steps compares pixels. Wide scales respond to brightness as well as to position: the light
# that a plan omits displaces their minimum.
FINISH: Final = 0.25
FINISH_RATE: Final = 0.1
# An exact finish has eight times the samples, and less momentum than Adam's default of 0.9: with the default, so short
# a finish would end while it still oscillates.
FINISH_SAMPLES: Final = 8
FINISH_MOMENTUM: Final = 0.5


@dataclass(frozen=True)
class Setting:
    """Objective and optimiser settings of a fit. Their names and values identify stored runs.

    Attributes
    ----------
    name : {"published", "ours"}
        Protocol. "published": Adam at 0.01 world units, and the paper's scales. "ours": rates in pixels with a cosine
        decay, and the library's default scales and stages. Both have the same bounds.
    method : str
        Objective. Methods with ``prdpt`` estimate their gradient from ten images at random parameters; all others use
        the planned gradients of Mitsuba.
    rate : float
        Learning rate of Adam, in units of the protocol.
    steps : int
        Number of steps.
    finish : float
        Final fraction of the steps, which compares pixels, at :data:`FINISH_RATE` of the rate.
    exact : bool
        Whether the images of the finish have all light paths and more samples, and its steps less momentum.
    colours : {"channels", "differences"}
        Channels of the LOI objective.
    staged : bool
        Whether the LOI objective begins with wide scales, as by default.
    sigma, final_sigma : float
        Standard deviation of the blur over parameters, in world units. It is constant for half of the steps before the
        finish, whose blur is `final_sigma`.
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
        """Whether the fit differentiates images blurred over their parameters."""
        return self.method in ("prdpt", "loi_prdpt")

    @property
    def compares(self) -> str:
        """Name of the objective."""
        return {"prdpt": "pixel_l2", "loi_prdpt": "loi"}.get(self.method, self.method)


def ours(method: Method, rate: float) -> Setting:
    """Return the setting of our protocol at a rate in pixels."""
    finish = FINISH if method in ("loi", "loi_prdpt") else 0.0
    return Setting("ours", method, rate, finish=finish, exact=method == "loi")


def for_many_objects(setting: Setting) -> Setting:
    """Return a setting for scenes where many objects move in the shadows of others.

    It has twice the steps. The LOI objective then compares differences of colours, which ignore shadows, and starts
    without the widest scales, whose blur merges neighbouring objects. The remaining error is far larger than the
    error that an exact finish removes.
    """
    longer = replace(setting, steps=200, exact=False)
    return replace(longer, colours="differences", staged=False) if setting.compares == "loi" else longer


# The number of steps is not published. PRDPT's example has 400, which the farthest start needs at this rate.
PUBLISHED: Final = {method: Setting("published", method, 0.01, steps=400, staged=False) for method in LABELS}

# Pixels that the image moves per step: candidates of the search for the best rate of each method.
RATES: Final = (1.0, 3.0, 9.0)
CHOSEN: Final = dict.fromkeys(LABELS, 3.0) | {"ms_ssim": 9.0}
PROTOCOLS: Final = {"ours": {method: ours(method, CHOSEN[method]) for method in LABELS}, "published": PUBLISHED}

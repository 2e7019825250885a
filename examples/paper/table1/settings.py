"""How a fit is done: the two protocols, each rival's settings, and what is left out in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from loi_core import ScaleSpace
from loi_core.fit import Decay

__all__ = ["ABLATIONS", "LABELS", "OURS", "PROTOCOLS", "PUBLISHED", "Method", "Setting"]

Method = Literal["loi", "gaussian_pyramid", "ms_ssim", "lpips_alex", "lpips_vgg", "pixel_l2"]

LABELS: Final[dict[Method, str]] = {
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "lpips_vgg": "LPIPS (VGG)",
    "loi": "loi (ours)",
}


@dataclass(frozen=True)
class Setting:
    """One way to fit.

    Attributes
    ----------
    name : str
        Of the protocol or ablation.
    method : str
        Which objective.
    rate : float
        Adam's, pixels a step in an image of 128; in proportion to the side in others.
    scales : ScaleSpace, "for_image" or "every", optional
        Of our objective: these, ``ScaleSpace.for_image``, or every scale from a pixel to a third of the side, inner and
        extent alike; the latter two with bounds that hold the reference.
    accuracy : str
        Of our objective.
    steps : int
        Of the fit.
    decay : {"cosine", "none"}
        Of the rate.
    kept : {"best", "last"}
        Which iterate counts: the one with the least loss, or the last.
    moves : {"ours", "released"}
        Who parts disks and keeps them in the frame.
    """

    name: str
    method: Method
    rate: float
    scales: ScaleSpace | Literal["for_image", "every"] | None = None
    accuracy: str = "balanced"
    steps: int = 500
    decay: Decay = "cosine"
    kept: Literal["best", "last"] = "best"
    moves: Literal["ours", "released"] = "ours"


# Adam at 0.1 quarters of the side, 500 steps, the last iterate, black outside: config.py and multi_shape.py.
_PUBLISHED: Final = Setting("published", "loi", rate=3.2, decay="none", kept="last", moves="released")
PUBLISHED: Final = {
    method: replace(
        _PUBLISHED,
        method=method,
        scales=ScaleSpace.released((1, 5, 15, 45), (1, 5, 15), 8, 121) if method == "loi" else None,
    )
    for method in LABELS
}

# The best of the search of `tuning`, on seeds of its own; for ours, which finds everything with all rates from 2 to 16
# there, one within that range: at its end a start that needs more steps may not come all the way.
RATES: Final[dict[Method, float]] = {
    "loi": 4.0,
    "gaussian_pyramid": 8.0,
    "ms_ssim": 4.0,
    "lpips_alex": 4.0,
    "lpips_vgg": 4.0,
    "pixel_l2": 8.0,
}
OURS: Final = {
    method: Setting("ours", method, rate, scales="every" if method == "loi" else None) for method, rate in RATES.items()
}
PROTOCOLS: Final = {"published": PUBLISHED, "ours": OURS}

# Of a square image of 128 pixels.
_ALL: Final = (1, 5, 15, 45)
_SCALES: Final[dict[str, ScaleSpace | Literal["for_image", "every"]]] = {
    "every scale": "every",
    "for_image": "for_image",
    "the paper's": ScaleSpace.paper("vector"),
    "every scale, black outside": ScaleSpace(_ALL, _ALL, 0.125, boundary="zero"),
    "no extent of 1": ScaleSpace(_ALL, _ALL[1:], 0.125),
    "sigma 1 alone": ScaleSpace(1, _ALL, 0.125),
    "sigma 0 alone": ScaleSpace(0, _ALL, 0.125),
    "no alpha (pixels of blurred images)": ScaleSpace(_ALL, 0, 0.125),
    "sigma 0, no alpha (pixels)": ScaleSpace(0, 0, 0.125),
    "no beta (means)": ScaleSpace(_ALL, _ALL, 4.0),
    "beta 1/4": ScaleSpace(_ALL, _ALL, 0.25),
    "beta 1/16": ScaleSpace(_ALL, _ALL, 0.0625),
    "p 1/2 (squares)": ScaleSpace(_ALL, _ALL, 0.125, p=0.5),
    "p 2 (roots)": ScaleSpace(_ALL, _ALL, 0.125, p=2.0),
}
ABLATIONS: Final = (
    *(replace(OURS["loi"], name=name, scales=scales) for name, scales in _SCALES.items()),
    replace(OURS["loi"], name="exact", accuracy="exact"),
    replace(OURS["loi"], name="constant rate", decay="none"),
    replace(OURS["loi"], name="constant rate, last iterate", decay="none", kept="last"),
    replace(OURS["loi"], name="parted as released", moves="released"),
)

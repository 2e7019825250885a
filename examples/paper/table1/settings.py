"""How a fit is done: the two protocols, and each baseline's settings."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Final, Literal

from loi_core import ScaleSpace
from loi_core.fitting.loop import Decay

__all__ = ["LABELS", "OURS", "PROTOCOLS", "PUBLISHED", "Method", "Setting"]

Method = Literal["loi", "gaussian_pyramid", "ms_ssim", "lpips_alex", "lpips_vgg", "pixel_l2"]

LABELS: Final[dict[Method, str]] = {
    "pixel_l2": "pixel L2",
    "gaussian_pyramid": "Gaussian pyramid",
    "ms_ssim": "MS-SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "lpips_vgg": "LPIPS (VGG)",
    "loi": "loi (ours)",
}


# Of fields that came later: told only where they are not at their default, so that what was done before stays done.
LATER: Final = {"later": True}


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
    scales : ScaleSpace, "for_image", "every" or "wide", optional
        Of our objective: these, ``ScaleSpace.for_image``, every scale from a pixel to a third of the side, inner and
        extent alike, or those without the extent of a pixel; but for the first with bounds that hold the reference.
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
    before : Setting, optional
        A fit that goes before this one, which then starts from the iterate that counts there.
    noise : float
        Standard deviation of Gaussian noise on every render of the fit, none of it on the image that counts.
    channels : {"rgb", "sums"}
        What our objective compares: red, green and blue, or all their 13 sums and differences.
    levels : {"once", "twice"}
        Of our objective: the levels of its scales, or with as many others halfway between them.
    both_orders : bool
        Whether half of the gradient is that of the disks painted in the opposite order, where what is hidden shows.
    """

    name: str
    method: Method
    rate: float
    scales: ScaleSpace | Literal["for_image", "every", "wide"] | None = None
    accuracy: str = "balanced"
    steps: int = 500
    decay: Decay = "cosine"
    kept: Literal["best", "last"] = "best"
    moves: Literal["ours", "released"] = "ours"
    before: Setting | None = field(default=None, metadata=LATER)
    noise: float = field(default=0.0, metadata=LATER)
    channels: Literal["rgb", "sums"] = field(default="rgb", metadata=LATER)
    levels: Literal["once", "twice"] = field(default="once", metadata=LATER)
    both_orders: bool = field(default=False, metadata=LATER)

    def __repr__(self) -> str:
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        told = [one.name for one in fields(self) if "later" not in one.metadata or values[one.name] != one.default]
        return f"Setting({', '.join(f'{name}={values[name]!r}' for name in told)})"

    @property
    def stages(self) -> tuple[Setting, ...]:
        """The fits that it takes, in their order; itself is the last."""
        return (*(self.before.stages if self.before else ()), self)

    def limited(self, steps: int) -> Setting:
        """The same with this many steps in each of its fits."""
        return replace(self, steps=steps, before=self.before.limited(steps) if self.before else None)


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

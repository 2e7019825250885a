"""Settings of a fit: both protocols, for every method."""

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


# Marks fields younger than the first records. `repr` omits such a field at its default, so that old records match.
ADDED_LATER: Final = {"added later": True}


@dataclass(frozen=True)
class Setting:
    """Objective and optimiser settings of a fit. Their names and values identify stored runs.

    Attributes
    ----------
    name : str
        Protocol or ablation.
    method : str
        Objective.
    rate : float
        Learning rate of Adam, in pixels per step for a side of 128 pixels; it scales with the side.
    scales : ScaleSpace, "for_image", "every" or "wide", optional
        Scales of the LOI objective. "for_image" is ``ScaleSpace.for_image``. "every" has inner and outer scales from a
        pixel to a third of the side, and "wide" the same without the outer scale of a pixel. Named scales have bounds
        that contain the reference.
    accuracy : str
        Accuracy of the LOI objective.
    steps : int
        Steps of this stage.
    decay : {"cosine", "none"}
        Decay of the rate.
    kept : {"best", "last"}
        The resulting iterate: the iterate with the smallest loss, or the last.
    moves : {"ours", "released"}
        The rule that separates disks and confines them to the frame.
    before : Setting, optional
        Preceding stage, whose resulting iterate is the start of this stage.
    noise : float
        Standard deviation of Gaussian noise on every render of the fit, but not on the measured image.
    channels : {"rgb", "sums"}
        Channels of the LOI objective: red, green and blue, or their 13 sums and differences.
    levels : {"once", "twice"}
        Tonal levels of the LOI objective: the levels of its scales, or also the levels halfway between.
    both_orders : bool
        Whether to average the gradient with the gradient of the opposite painting order, which shows hidden disks.
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
    before: Setting | None = field(default=None, metadata=ADDED_LATER)
    noise: float = field(default=0.0, metadata=ADDED_LATER)
    channels: Literal["rgb", "sums"] = field(default="rgb", metadata=ADDED_LATER)
    levels: Literal["once", "twice"] = field(default="once", metadata=ADDED_LATER)
    both_orders: bool = field(default=False, metadata=ADDED_LATER)

    def __repr__(self) -> str:
        values = [(attribute, getattr(self, attribute.name)) for attribute in fields(self)]
        shown = (
            f"{attribute.name}={value!r}"
            for attribute, value in values
            if attribute.metadata != ADDED_LATER or value != attribute.default
        )
        return f"Setting({', '.join(shown)})"

    @property
    def stages(self) -> tuple[Setting, ...]:
        """All stages in their order; this setting is the last."""
        return (*(self.before.stages if self.before else ()), self)

    def limited(self, steps: int) -> Setting:
        """Return the setting with `steps` steps in every stage."""
        return replace(self, steps=steps, before=self.before.limited(steps) if self.before else None)


# Adam at 0.1 quarters of the side, 500 steps, the last iterate, black outside the image, as in config.py and
# multi_shape.py of the released code.
_PUBLISHED: Final = Setting("published", "loi", rate=3.2, decay="none", kept="last", moves="released")
PUBLISHED: Final = {
    method: replace(
        _PUBLISHED,
        method=method,
        scales=ScaleSpace.released((1, 5, 15, 45), (1, 5, 15), 8, 121) if method == "loi" else None,
    )
    for method in LABELS
}

# The best rates of the search in `tuning`, on other seeds. There the LOI objective finds every disk at all rates from 2
# to 16. Its rate is well inside that range, because at either end a start that needs more steps may not arrive.
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

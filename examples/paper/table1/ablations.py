"""Ours with one thing changed: what each part is for."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal

from examples.paper.table1.settings import OURS
from loi_core import ScaleSpace

__all__ = ["ABLATIONS", "WIDTHS"]

# Of a square image of 128 pixels.
WIDTHS: Final = (1, 5, 15, 45)
_SCALES: Final[dict[str, ScaleSpace | Literal["for_image", "every"]]] = {
    "every scale": "every",
    "for_image": "for_image",
    "the paper's": ScaleSpace.paper("vector"),
    "every scale, black outside": ScaleSpace(WIDTHS, WIDTHS, 0.125, boundary="zero"),
    "no extent of 1": ScaleSpace(WIDTHS, WIDTHS[1:], 0.125),
    "sigma 1 alone": ScaleSpace(1, WIDTHS, 0.125),
    "sigma 0 alone": ScaleSpace(0, WIDTHS, 0.125),
    "no alpha (pixels of blurred images)": ScaleSpace(WIDTHS, 0, 0.125),
    "sigma 0, no alpha (pixels)": ScaleSpace(0, 0, 0.125),
    "no beta (means)": ScaleSpace(WIDTHS, WIDTHS, 4.0),
    "beta 1/4": ScaleSpace(WIDTHS, WIDTHS, 0.25),
    "beta 1/16": ScaleSpace(WIDTHS, WIDTHS, 0.0625),
    "p 1/2 (squares)": ScaleSpace(WIDTHS, WIDTHS, 0.125, p=0.5),
    "p 2 (roots)": ScaleSpace(WIDTHS, WIDTHS, 0.125, p=2.0),
}
# Taps for all of the widest extent that matters; the inner kernels get half as many, two standard deviations a side.
_RELEASED_LEVELS: Final = ScaleSpace(WIDTHS, WIDTHS, 0.125, convention="released", kernel_size=361)
_OURS: Final = OURS["loi"]
# Narrow extents hold a disk where it covers a little of its colour, so wide ones go first, at the full rate: as long
# as a disk takes to cross the image once and a half. No longer: only narrow ones tell neighbours apart.
_WIDE: Final = replace(_OURS, name="wide extents", scales="wide", steps=50, decay="none")
# Whether it is the wide extents that help, or the full rate of those steps and the fresh start after them.
_EVERY: Final = replace(_OURS, steps=50, decay="none")
ABLATIONS: Final = (
    *(replace(_OURS, name=name, scales=scales) for name, scales in _SCALES.items()),
    replace(_OURS, name="wide extents first", steps=450, before=_WIDE),
    replace(_OURS, name="every scale first", steps=450, before=_EVERY),
    replace(_OURS, name="9 levels, none beyond the range", scales=ScaleSpace(WIDTHS, WIDTHS, 0.125, tails=0.0)),
    replace(_OURS, name="8 levels, 2 beta apart (as released)", scales=_RELEASED_LEVELS),
    replace(_OURS, name="35 levels, beta/2 apart", levels="twice"),
    replace(_OURS, name="exact", accuracy="exact"),
    replace(_OURS, name="constant rate", decay="none"),
    replace(_OURS, name="constant rate, last iterate", decay="none", kept="last"),
    replace(_OURS, name="parted as released", moves="released"),
)

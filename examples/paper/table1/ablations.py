"""Ablations: our setting with one change each."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal

from examples.paper.table1.settings import OURS
from loi_core import ScaleSpace

__all__ = ["ABLATIONS", "WIDTHS"]

# Standard deviations in pixels, for a square image of 128 pixels.
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
# 361 taps cover four standard deviations of the widest extent on either side. The inner kernels have half as many taps,
# two standard deviations on either side.
_RELEASED_LEVELS: Final = ScaleSpace(WIDTHS, WIDTHS, 0.125, convention="released", kernel_size=361)
_LOI: Final = OURS["loi"]
# Narrow extents trap a disk that overlaps its target colour a little, so wide extents come first, at the full rate, for
# as long as a disk needs to cross the image one and a half times. Only narrow extents distinguish neighbouring disks.
_WIDE_STAGE: Final = replace(_LOI, name="wide extents", scales="wide", steps=50, decay="none")
# The control of the stage above: the full rate and the restart of Adam, without the wide extents.
_EVERY_SCALE_STAGE: Final = replace(_LOI, steps=50, decay="none")
ABLATIONS: Final = (
    *(replace(_LOI, name=name, scales=scales) for name, scales in _SCALES.items()),
    replace(_LOI, name="wide extents first", steps=450, before=_WIDE_STAGE),
    replace(_LOI, name="every scale first", steps=450, before=_EVERY_SCALE_STAGE),
    replace(_LOI, name="9 levels, none beyond the range", scales=ScaleSpace(WIDTHS, WIDTHS, 0.125, tails=0.0)),
    replace(_LOI, name="8 levels, 2 beta apart (as released)", scales=_RELEASED_LEVELS),
    replace(_LOI, name="35 levels, beta/2 apart", levels="twice"),
    replace(_LOI, name="exact", accuracy="exact"),
    replace(_LOI, name="constant rate", decay="none"),
    replace(_LOI, name="constant rate, last iterate", decay="none", kept="last"),
    replace(_LOI, name="parted as released", moves="released"),
)

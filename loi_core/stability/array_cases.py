"""Hard cases of ties, of batches, and of how arrays lie in memory."""

from __future__ import annotations

import numpy as np

from loi_core.errors import ImageTypeError, NonFiniteImageError
from loi_core.method.scales import ScaleSpace
from loi_core.stability import layouts
from loi_core.stability.case import HardCase, Pair, pair, spoilt
from loi_core.stability.pictures import SHAPE, board, flat, render

__all__ = ["array_cases", "batch_cases", "tie_cases"]


def tie_cases() -> list[HardCase]:
    """Where the cost has no derivative, or an infinite one."""

    def mirrored() -> Pair:
        image = np.where(np.arange(SHAPE[1])[None, :, None] < SHAPE[1] // 2, 0.25, 0.75) + np.zeros(SHAPE)
        return image, image[:, ::-1].copy()

    return [
        HardCase(
            "ties",
            "two halves in each other's place: where they meet, |x| has no derivative, and libraries disagree",
            "a difference that rounding alone could have made has the derivative 0",
            mirrored,
            ScaleSpace(0.0, (1.0, 200.0), 0.125),
        ),
        HardCase(
            "checkerboard against its inverse",
            "the finest pattern there is, and its opposite: blurred they are the same, and the rest is noise",
            "alpha = 0 tells them apart; where they are the same, they are ties",
            lambda: (board(), board(first=1.0, second=0.0)),
            ScaleSpace(0.0, (0.0, 4.0), 0.125),
            half=True,
        ),
        HardCase(
            "checkerboard against grey",
            "they have the same mean, so a pyramid sees no difference at all",
            "histograms of black and white are not those of grey",
            lambda: (board(), flat(0.5)),
        ),
        HardCase(
            "p = 2",
            "|d|**(1/2) is infinitely steep at 0, where most differences are",
            "the tie rule ends the slope at 16 roundings; steep it stays, and the bound says by how much",
            pair,
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=2.0),
        ),
        HardCase(
            "p = 2, identical images",
            "0 times infinity",
            "no difference, no slope",
            lambda: (render(0.5, 0.5), render(0.5, 0.5)),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=2.0),
        ),
        HardCase(
            "p = 1/2",
            "squares of small differences underflow",
            "they are then below rounding of the sum anyway",
            pair,
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=0.5),
        ),
    ]


def batch_cases() -> list[HardCase]:
    """Several images at once."""

    def batch(value: float) -> Pair:
        image, reference = spoilt(value)
        return np.stack([render(0.3, 0.6), image]), np.stack([reference, reference])

    return [
        HardCase(
            "batch",
            "one image's gradient reaches another's",
            "images of a batch are planes that never meet",
            lambda: batch(0.5),
        ),
        HardCase(
            "batch with one bad image",
            "the good image is lost with the bad",
            "an error that says which one is bad",
            lambda: batch(np.nan),
            error=NonFiniteImageError,
        ),
        HardCase(
            "batch with one bad image, masked",
            "a NaN spreads to the other image",
            "the other image's gradient is the same",
            lambda: batch(np.nan),
            nan_policy="mask",
        ),
        HardCase(
            "batch with one black image",
            "one image is far off and the other nearly right",
            "the mean over the batch; neither changes the other's share",
            lambda: (np.stack([flat(0.0), pair()[0]]), pair()[1]),
        ),
    ]


def array_cases() -> list[HardCase]:
    """Arrays that lie in memory in unusual ways, and those that are no images."""
    views = [
        ("not contiguous", layouts.strided, "a library reads memory in order and sees another image"),
        ("negative strides", layouts.negative_strides, "as before; torch takes no such array"),
        ("zero strides", layouts.zero_strides, "a broadcast view: writing to one pixel writes to many"),
        ("read-only", layouts.read_only, "in-place arithmetic on the caller's memory fails, or worse, does not"),
    ]
    others = [
        (
            "big-endian",
            layouts.big_endian,
            "numbers read in the wrong order of bytes",
            "refused: the conversion is named",
        ),
        (
            "masked array",
            layouts.masked,
            "most functions forget the mask",
            "refused: fill it and pass nan_policy='mask'",
        ),
        ("8-bit integers", layouts.bytes_of_image, "255 is taken for a radiance of 255", "refused: divide by 255"),
        ("boolean image", layouts.booleans, "a gradient that only has two values", "refused: convert it first"),
        (
            "complex image",
            layouts.complex_numbers,
            "|z| and its derivative are another loss",
            "refused: convert it first",
        ),
        ("object array", layouts.objects, "slow, and any object may hide in it", "refused: convert it first"),
    ]
    return [
        *(
            HardCase(name, danger, "read as it is, never written to", pair, layout=layout)
            for name, layout, danger in views
        ),
        *(
            HardCase(name, danger, answer, pair, error=ImageTypeError, layout=layout)
            for name, layout, danger, answer in others
        ),
    ]

"""Hard cases of ties, of batches, and of memory layouts."""

from __future__ import annotations

from functools import partial

import numpy as np

from loi_core.errors import ImageTypeError, NonFiniteImageError
from loi_core.method.scales import ScaleSpace
from loi_core.stability.case import SHAPE, HardCase, Pair, checkerboard, disk, flat, pair, pair_with_outliers
from loi_core.support.arrays import Host

__all__ = ["array_cases", "batch_cases", "tie_cases"]


def tie_cases() -> list[HardCase]:
    """Return cases where the cost has no derivative, or an infinite one."""

    def mirrored() -> Pair:
        image = np.where(np.arange(SHAPE[1])[None, :, None] < SHAPE[1] // 2, 0.25, 0.75) + np.zeros(SHAPE)
        return image, image[:, ::-1].copy()

    squared, rooted = (ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=p) for p in (2.0, 0.5))
    return [
        HardCase(
            "ties",
            "|x| has no derivative at 0, and libraries disagree",
            "a difference within rounding has derivative 0",
            mirrored,
            ScaleSpace(0.0, (1.0, 200.0), 0.125),
        ),
        HardCase(
            "checkerboard against its inverse",
            "blurred, they are equal up to noise",
            "alpha = 0 distinguishes them",
            lambda: (checkerboard(), checkerboard(1.0, 0.0)),
            ScaleSpace(0.0, (0.0, 4.0), 0.125),
            half=True,
        ),
        HardCase(
            "checkerboard against grey",
            "their means are equal",
            "histograms of black and white differ from grey",
            lambda: (checkerboard(), flat(0.5)),
        ),
        HardCase("p = 2", "|d|**(1/2) is infinitely steep at 0", "the tie rule limits the slope", pair, squared),
        HardCase(
            "p = 2, identical images",
            "0 times infinity",
            "no difference has no slope",
            lambda: (disk(0.5, 0.5), disk(0.5, 0.5)),
            squared,
        ),
        HardCase("p = 1/2", "squares underflow", "they are then below the rounding of the sum", pair, rooted),
    ]


def batch_cases() -> list[HardCase]:
    """Return cases of several images at once."""

    def batch(value: float) -> Pair:
        image, reference = pair_with_outliers(value)
        return np.stack([disk(0.3, 0.6), image]), np.stack([reference, reference])

    def black() -> Pair:
        return np.stack([flat(0.0), pair()[0]]), pair()[1]

    bad = partial(batch, np.nan)
    spreads, unchanged = "a NaN spreads to the other image", "the other image's gradient is unchanged"
    share = "the mean over the batch; neither changes the other's term"
    return [
        HardCase("batch", "images affect each other", "images of a batch are separate planes", partial(batch, 0.5)),
        HardCase("batch with one bad image", spreads, "the error names it", bad, error=NonFiniteImageError),
        HardCase("batch with one bad image, masked", spreads, unchanged, bad, nan_policy="mask"),
        HardCase("batch with one black image", "one image is far off, the other nearly right", share, black),
    ]


def array_cases() -> list[HardCase]:
    """Return cases of unusual memory layouts, and of arrays that are not images."""

    def strided(image: Host) -> Host:
        height, width, channels = image.shape
        larger = np.full((channels, 2 * height, 3 * width), np.nan, image.dtype)
        view = np.moveaxis(larger, 0, -1)[::2, ::3]
        view[...] = image
        return view

    def read_only(image: Host) -> Host:
        copy = image.copy()
        copy.flags.writeable = False
        return copy

    def masked(image: Host) -> Host:
        return np.ma.MaskedArray(image, mask=image > 0.5)

    order, convert = ">" if np.little_endian else "<", "refused: convert it first"
    views = (
        ("not contiguous", "a library reads memory in order", strided),
        (
            "negative strides",
            "torch accepts no such array",
            lambda image: np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1],
        ),
        (
            "zero strides",
            "a write to one pixel writes to many",
            lambda image: np.broadcast_to(image[..., :1], image.shape),
        ),
        ("read-only", "in-place arithmetic fails", read_only),
    )
    invalid = (
        (
            "big-endian",
            "bytes in the wrong order",
            "refused: use astype",
            lambda image: image.astype(image.dtype.newbyteorder(order)),
        ),
        ("masked array", "most functions ignore the mask", "refused: fill it and pass nan_policy='mask'", masked),
        (
            "8-bit integers",
            "255 is read as a radiance",
            "refused: divide by 255",
            lambda image: (image * 255.0).astype(np.uint8),
        ),
        ("boolean image", "its gradient has two values", convert, lambda image: image > 0.5),
        ("complex image", "|z| and its derivative are another loss", convert, lambda image: image.astype(np.complex64)),
        ("object array", "it is slow, and holds any object", convert, lambda image: image.astype(object)),
    )
    unchanged, error = "it is read without a copy and never written to", ImageTypeError
    return [
        *(HardCase(name, danger, unchanged, pair, layout=layout) for name, danger, layout in views),
        *(HardCase(name, danger, answer, pair, error=error, layout=layout) for name, danger, answer, layout in invalid),
    ]

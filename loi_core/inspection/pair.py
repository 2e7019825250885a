"""The two images that are inspected: read from files, or one of them and itself moved a little."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from loi_core.errors import OptionError, ScaleError
from loi_core.io.images import FloatImage
from loi_core.method.scales import Preset, ScaleSpace
from loi_core.pixels.bounds import RangeWarning, warn_if_clipped
from loi_core.pixels.nonfinite import require_finite
from loi_core.scenes.target import read_target

__all__ = ["MOST_PIXELS", "Pair", "averaged", "make_pair", "moved", "read_pair", "shrunk_scales"]

MOST_PIXELS: Final = 2**20
"""Of an image that is computed as it is. Larger ones are averaged over blocks of pixels before."""

SMALL_SHIFT: Final = 0.01  # of the longer side: how far a picture alone is moved


@dataclass(frozen=True)
class Pair:
    """An image and a reference, as they are computed.

    Attributes
    ----------
    image, reference : array, shape (h, w, C), float64
        C is 3, or 1 if both are grey; averaged over `factor` x `factor` pixels.
    names : (str, str)
        What to call them.
    height, width : int
        Of the files, in pixels.
    factor : int
        Side of the blocks that one pixel here is the mean of.
    scales : ScaleSpace
        In pixels of the files.
    shift : int
        How many pixels of the files the image is moved to the right of the reference, if both are one picture; else 0.
    notes : tuple of str
        What was done to the files, a line each.
    """

    image: FloatImage
    reference: FloatImage
    names: tuple[str, str]
    height: int
    width: int
    factor: int
    scales: ScaleSpace
    shift: int = 0
    notes: tuple[str, ...] = ()

    @property
    def computed_scales(self) -> ScaleSpace:
        """The scales in pixels of what is computed."""
        return shrunk_scales(self.scales, self.factor)


def read_pair(
    image: Path, reference: Path | None, *, preset: Preset | None, bounds: tuple[float, float] | None
) -> Pair:
    """Read one picture or two.

    Parameters
    ----------
    image, reference : path
        Files of :func:`loi_core.read_target`.
    preset : {"vector", "path", "raster"}, optional
        The paper's scales, instead of those for the size of the image.
    bounds : (float, float), optional
        Those of the scales, instead of 0 and 1.

    Raises
    ------
    ImageFileError
        If a file cannot be read.
    OptionError
        If the two differ in size, or another argument is not allowed.
    NonFiniteImageError
        If a value is NaN or infinite.
    """
    ours = read_target(image)
    theirs = None if reference is None else read_target(reference)
    height, width = ours.image.shape[:2]
    if theirs is not None and theirs.image.shape != ours.image.shape:
        rows, columns = theirs.image.shape[:2]
        msg = f"`IMAGE` and `REFERENCE` must be of one size, got {width} x {height} and {columns} x {rows} pixels"
        raise OptionError(msg)
    if preset is not None:
        scales = ScaleSpace.paper(preset)
        scales = scales if bounds is None else replace(scales, bounds=bounds)
    else:
        scales = ScaleSpace.for_image(height, width, bounds=(0.0, 1.0) if bounds is None else bounds)
    notes = ours.notes if theirs is None else (*ours.notes, *theirs.notes)
    names = (image.name, None if reference is None else reference.name)
    return make_pair(ours.image, None if theirs is None else theirs.image, scales, names=names, notes=notes)


def make_pair(
    image: FloatImage,
    reference: FloatImage | None,
    scales: ScaleSpace,
    *,
    names: tuple[str, str | None] = ("image", None),
    notes: tuple[str, ...] = (),
) -> Pair:
    """What is inspected of arrays, shape (H, W, C); an image alone is compared with itself, moved a little.

    Raises
    ------
    NonFiniteImageError
        If a value is NaN or infinite.
    ScaleError
        If the scales are those of the released code, whose scales are not comparable one by one.
    """
    if scales.convention != "paper":
        msg = f"`scales` must follow the convention 'paper' to be looked at one by one, got {scales.convention!r}"
        raise ScaleError(msg)
    for name, each in (("image", image), ("reference", reference)):
        if each is not None:
            require_finite(name, each, -1)
    height, width = image.shape[:2]
    factor, shift = math.ceil(math.sqrt(height * width / MOST_PIXELS)), 0
    if reference is None:
        shift = min(max(1, round(SMALL_SHIFT * max(height, width) / factor)) * factor, width - 1)
    told = [*notes, *_clipped(image if reference is None else reference, scales)]
    if factor > 1:
        told.append(
            f"the files have {width} x {height} pixels, too many to look at each; what is computed are means of "
            f"{factor} x {factor}, so numbers are close to those of the files, not the same; lengths are in pixels of "
            f"the files"
        )
    image = averaged(image, factor)
    if reference is None:
        ours, theirs = moved(image, 0, shift // factor), image
    else:
        ours, theirs = image, averaged(reference, factor)
    if all(np.array_equal(each[..., :1].repeat(each.shape[-1], axis=-1), each) for each in (ours, theirs)):
        ours, theirs = ours[..., :1], theirs[..., :1]
    first, second = names
    called = (first, second) if second is not None else (f"{first}, moved {shift} px to the right", first)
    return Pair(ours, theirs, called, height, width, factor, scales, shift, notes=tuple(told))


def averaged(image: FloatImage, factor: int) -> FloatImage:
    """The means of blocks of `factor` x `factor` pixels, shape (h, w, C); those at the far edges may be smaller."""
    if factor == 1:
        return image
    for axis in (0, 1):
        first = np.arange(0, image.shape[axis], factor)
        counts = np.diff(np.append(first, image.shape[axis]))
        image = np.add.reduceat(image, first, axis=axis) / np.expand_dims(counts, tuple({0, 1, 2} - {axis}))
    return image


def moved(image: FloatImage, down: int, right: int) -> FloatImage:
    """An image, shape (H, W, C), moved by whole pixels; what comes in at an edge is the edge."""
    rows, columns = (np.arange(size) for size in image.shape[:2])
    rows = np.clip(rows - down, 0, image.shape[0] - 1)
    columns = np.clip(columns - right, 0, image.shape[1] - 1)
    result: FloatImage = image[rows][:, columns]
    return result


def shrunk_scales(scales: ScaleSpace, factor: int) -> ScaleSpace:
    """Scales in pixels that are `factor` times as large."""
    if factor == 1:
        return scales
    sigma, alpha = (tuple(one / factor for one in each) for each in (scales.sigma, scales.alpha))
    return replace(scales, sigma=sigma, alpha=alpha)


def _clipped(reference: FloatImage, scales: ScaleSpace) -> list[str]:
    """What is to be said of values beyond the bounds, as an objective says it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RangeWarning)
        warn_if_clipped(reference, None, scales.bounds)
    return [f"{one.message}" for one in caught]

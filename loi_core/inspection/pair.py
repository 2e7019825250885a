"""The pair of images to inspect: two files, or one and itself shifted a little."""

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
from loi_core.pixels.bounds import RangeWarning, warn_if_out_of_range
from loi_core.pixels.nonfinite import require_finite
from loi_core.scenes.target import read_target

__all__ = ["MAX_PIXELS", "Pair", "averaged", "make_pair", "read_pair", "scaled_down", "shifted"]

MAX_PIXELS: Final = 2**20
"""Larger images are averaged over blocks of pixels first."""

SHIFT_FRACTION: Final = 0.01  # shift of a single image, relative to its longer side


@dataclass(frozen=True)
class Pair:
    """An image and a reference as they are compared.

    Attributes
    ----------
    image, reference : array, shape (h, w, C), float64
        C is 3, or 1 if both are grey. Each pixel is the mean of `factor` x `factor` pixels of the file.
    names : (str, str)
    height, width : int
        In pixels of the files.
    factor : int
    scales : ScaleSpace
        In pixels of the files.
    shift : int
        For a single image, its shift to the right in pixels of the file; otherwise 0.
    notes : tuple of str
        Changes to the files, a line each.
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
        """The scales in pixels of `image` and `reference`."""
        return scaled_down(self.scales, self.factor)


def read_pair(
    image: Path, reference: Path | None, *, preset: Preset | None, bounds: tuple[float, float] | None
) -> Pair:
    """Read one image or two.

    Parameters
    ----------
    image, reference : path
        Files of :func:`loi_core.read_target`.
    preset : {"vector", "path", "raster"}, optional
        The paper's scales, instead of those for the size of the image.
    bounds : (float, float), optional
        The bounds of the scales, instead of 0 and 1.

    Raises
    ------
    ImageFileError
        If a file cannot be read.
    OptionError
        If the two differ in size, or another argument is not allowed.
    NonFiniteImageError
        If a value is NaN or infinite.
    """
    first = read_target(image)
    second = None if reference is None else read_target(reference)
    height, width = first.image.shape[:2]
    if second is not None and second.image.shape != first.image.shape:
        rows, columns = second.image.shape[:2]
        msg = f"`IMAGE` and `REFERENCE` must have the same size, got {width} x {height} and {columns} x {rows} pixels"
        raise OptionError(msg)
    if preset is not None:
        scales = ScaleSpace.paper(preset)
        scales = scales if bounds is None else replace(scales, bounds=bounds)
    else:
        scales = ScaleSpace.for_image(height, width, bounds=(0.0, 1.0) if bounds is None else bounds)
    notes = first.notes if second is None else (*first.notes, *second.notes)
    names = (image.name, None if reference is None else reference.name)
    return make_pair(first.image, None if second is None else second.image, scales, names=names, notes=notes)


def make_pair(
    image: FloatImage,
    reference: FloatImage | None,
    scales: ScaleSpace,
    *,
    names: tuple[str, str | None] = ("image", None),
    notes: tuple[str, ...] = (),
) -> Pair:
    """Return the pair of two arrays, shape (H, W, C); a single image is compared with itself, shifted a little.

    Raises
    ------
    NonFiniteImageError
        If a value is NaN or infinite.
    ScaleError
        If the scales follow the convention of the released code, whose scales cannot be compared one by one.
    """
    if scales.convention != "paper":
        msg = f"`scales` must follow the convention 'paper' to be inspected one by one, got {scales.convention!r}"
        raise ScaleError(msg)
    for name, array in (("image", image), ("reference", reference)):
        if array is not None:
            require_finite(name, array, -1)
    height, width = image.shape[:2]
    factor, shift = math.ceil(math.sqrt(height * width / MAX_PIXELS)), 0
    lines = [*notes, *_range_warnings(image if reference is None else reference, scales)]
    if factor > 1:
        lines.append(
            f"the files have {width} x {height} pixels, too many to compare each; means of {factor} x {factor} pixels "
            f"are compared, so numbers are close to those of the files, not equal; lengths are in pixels of the files"
        )
    image = averaged(image, factor)
    if reference is None:
        shift = min(max(1, round(SHIFT_FRACTION * max(height, width) / factor)) * factor, width - 1)
        image, reference = shifted(image, 0, shift // factor), image
    else:
        reference = averaged(reference, factor)
    if all(np.array_equal(array[..., :1].repeat(array.shape[-1], axis=-1), array) for array in (image, reference)):
        image, reference = image[..., :1], reference[..., :1]
    first, second = names
    labels = (first, second) if second is not None else (f"{first}, shifted {shift} px to the right", first)
    return Pair(image, reference, labels, height, width, factor, scales, shift, notes=tuple(lines))


def averaged(image: FloatImage, factor: int) -> FloatImage:
    """Return the means of blocks of `factor` x `factor` pixels, shape (h, w, C); the last blocks may be smaller."""
    if factor == 1:
        return image
    for axis in (0, 1):
        first = np.arange(0, image.shape[axis], factor)
        counts = np.diff(np.append(first, image.shape[axis]))
        image = np.add.reduceat(image, first, axis=axis) / np.expand_dims(counts, tuple({0, 1, 2} - {axis}))
    return image


def shifted(image: FloatImage, down: int, right: int) -> FloatImage:
    """Return an image, shape (H, W, C), shifted by whole pixels; the pixels at an edge are repeated."""
    rows, columns = (np.arange(size) for size in image.shape[:2])
    rows = np.clip(rows - down, 0, image.shape[0] - 1)
    columns = np.clip(columns - right, 0, image.shape[1] - 1)
    result: FloatImage = image[rows][:, columns]
    return result


def scaled_down(scales: ScaleSpace, factor: int) -> ScaleSpace:
    """Return scales in pixels that are `factor` times as large."""
    if factor == 1:
        return scales
    sigma, alpha = (tuple(length / factor for length in lengths) for lengths in (scales.sigma, scales.alpha))
    return replace(scales, sigma=sigma, alpha=alpha)


def _range_warnings(reference: FloatImage, scales: ScaleSpace) -> list[str]:
    """Return the warnings of an objective about values beyond the bounds."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RangeWarning)
        warn_if_out_of_range(reference, None, scales.bounds)
    return [f"{warning.message}" for warning in caught]

"""The objective of each setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np

from examples.paper.table1.problem import FloatArray, Image
from examples.paper.table1.settings import Setting
from loi_core import LOIObjective, ScaleSpace
from loi_core.objectives import MSSSIM, GaussianPyramid, Objective, PixelL2

__all__ = ["Sum", "Sums", "objective"]

MAX_WIDTH_FRACTION: Final = 0.36  # of the side: 45 pixels of 128


class Sum:
    """Sum of objectives."""

    def __init__(self, terms: Sequence[Objective]) -> None:
        self._terms = terms

    def value(self, image: Image) -> Image:
        """Return the sum."""
        values: Image = np.asarray(sum(term.value(image) for term in self._terms))
        return values

    def value_and_grad(self, image: Image) -> tuple[Image, Image]:
        """Return the sum and its gradient."""
        values, gradients = zip(*(term.value_and_grad(image) for term in self._terms), strict=True)
        return np.asarray(sum(values)), np.asarray(sum(gradients))


class Sums:
    """LOI objective on the 13 sums and differences of red, green and blue, each scaled to the range from 0 to 1."""

    def __init__(self, reference: Image, scales: ScaleSpace, accuracy: str) -> None:
        # The condition selects one vector from each pair of opposite vectors.
        vectors = product((-1.0, 0.0, 1.0), repeat=3)
        signs = np.array([vector for vector in vectors if vector > (0.0, 0.0, 0.0)])
        spans = np.abs(signs).sum(axis=1)
        self._mix: FloatArray = (signs / spans[:, None]).T  # (3, 13)
        self._minima: FloatArray = np.minimum(signs, 0.0).sum(axis=1) / spans
        self._objective = LOIObjective(self._mixed(reference), scales, accuracy=accuracy)

    def _mixed(self, image: Image) -> Image:
        return (image @ self._mix - self._minima).astype(image.dtype)

    def value(self, image: Image) -> Image:
        """Return the objective of the mixed image."""
        value: Image = self._objective.value(self._mixed(image))
        return value

    def value_and_grad(self, image: Image) -> tuple[Image, Image]:
        """Return the objective and its gradient by `image`, shape (H, W, 3)."""
        value, gradient = self._objective.value_and_grad(self._mixed(image))
        return value, (gradient @ self._mix.T).astype(image.dtype)


def objective(setting: Setting, reference: Image) -> Objective:
    """Return the objective of a setting."""
    if setting.method == "loi":
        return _loi(setting, reference)
    if setting.method == "gaussian_pyramid":
        return GaussianPyramid(reference)
    if setting.method == "ms_ssim":
        return MSSSIM(reference)
    if setting.method == "pixel_l2":
        return PixelL2(reference)
    from examples.paper.lib.lpips import lpips  # torch is slow to import

    return lpips(reference, "alex" if setting.method == "lpips_alex" else "vgg")


def _loi(setting: Setting, reference: Image) -> Objective:
    scales = _scales(setting, reference)
    if setting.channels == "sums":
        return Sums(reference, scales, setting.accuracy)
    once = LOIObjective(reference, scales, accuracy=setting.accuracy)
    if setting.levels == "once":
        return once
    # Levels are symmetric about the centre of the bounds: bounds wider by half a spacing on each side put the levels of
    # the second objective halfway between the levels of the first.
    lower, upper = scales.bounds
    half_spacing = 0.5 * scales.spacing(scales.beta[0])
    shifted_scales = replace(scales, bounds=(lower - half_spacing, upper + half_spacing))
    return Sum([once, LOIObjective(reference, shifted_scales, accuracy=setting.accuracy)])


def _scales(setting: Setting, reference: Image) -> ScaleSpace:
    """Return the scales of a setting for images of the size of `reference`.

    Derived scales have bounds that contain the reference: clipped noise would have a mean other than 0.
    """
    if isinstance(setting.scales, ScaleSpace):
        return setting.scales
    image_side = reference.shape[0]
    if setting.scales == "for_image":
        scales = ScaleSpace.for_image(image_side, image_side)
    else:
        widths = [1.0, 5.0, 15.0, 45.0]
        while 2.0 * widths[-1] <= MAX_WIDTH_FRACTION * image_side:
            widths.append(2.0 * widths[-1])
        scales = ScaleSpace(widths, widths if setting.scales == "every" else widths[1:], 0.125)
    return replace(scales, bounds=(min(0.0, float(reference.min())), max(1.0, float(reference.max()))))

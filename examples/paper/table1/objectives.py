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

WIDEST: Final = 0.36  # of the side: 45 pixels of 128


class Sum:
    """Several objectives, added."""

    def __init__(self, parts: Sequence[Objective]) -> None:
        self._parts = parts

    def value(self, image: Image) -> Image:
        """The sum."""
        values: Image = np.asarray(sum(part.value(image) for part in self._parts))
        return values

    def value_and_grad(self, image: Image) -> tuple[Image, Image]:
        """The sum and its gradient."""
        values, gradients = zip(*(part.value_and_grad(image) for part in self._parts), strict=True)
        return np.asarray(sum(values)), np.asarray(sum(gradients))


class Sums:
    """Our objective on all 13 sums and differences of red, green and blue, each in the range from 0 to 1."""

    def __init__(self, reference: Image, scales: ScaleSpace, accuracy: str) -> None:
        # One of each pair of opposite directions.
        signs = np.array([one for one in product((-1.0, 0.0, 1.0), repeat=3) if one > (0.0, 0.0, 0.0)])
        spans = np.abs(signs).sum(axis=1)
        self._mix: FloatArray = (signs / spans[:, None]).T  # (3, 13)
        self._least: FloatArray = np.minimum(signs, 0.0).sum(axis=1) / spans
        self._objective = LOIObjective(self._mixed(reference), scales, accuracy=accuracy)

    def _mixed(self, image: Image) -> Image:
        return (image @ self._mix - self._least).astype(image.dtype)

    def value(self, image: Image) -> Image:
        """The objective of the mixed image."""
        value: Image = self._objective.value(self._mixed(image))
        return value

    def value_and_grad(self, image: Image) -> tuple[Image, Image]:
        """The same, with its gradient by `image`, shape (H, W, 3)."""
        value, gradient = self._objective.value_and_grad(self._mixed(image))
        return value, (gradient @ self._mix.T).astype(image.dtype)


def objective(setting: Setting, reference: Image) -> Objective:
    """The objective of a setting."""
    if setting.method == "loi":
        return _ours(setting, reference)
    if setting.method == "gaussian_pyramid":
        return GaussianPyramid(reference)
    if setting.method == "ms_ssim":
        return MSSSIM(reference)
    if setting.method == "pixel_l2":
        return PixelL2(reference)
    from examples.paper.lib.lpips import lpips  # torch is slow to import, and only this method needs it

    return lpips(reference, "alex" if setting.method == "lpips_alex" else "vgg")


def _ours(setting: Setting, reference: Image) -> Objective:
    scales = _scales(setting, reference)
    if setting.channels == "sums":
        return Sums(reference, scales, setting.accuracy)
    once = LOIObjective(reference, scales, accuracy=setting.accuracy)
    if setting.levels == "once":
        return once
    # Levels stand symmetrically about the middle of the bounds, so half a spacing more on each side moves them by that.
    low, high = scales.bounds
    half = 0.5 * scales.spacing(scales.beta[0])
    between = replace(scales, bounds=(low - half, high + half))
    return Sum([once, LOIObjective(reference, between, accuracy=setting.accuracy)])


def _scales(setting: Setting, reference: Image) -> ScaleSpace:
    """The scales of a setting for images like `reference`.

    Unless they are given, their bounds hold all of the reference: where noise is cut off, its mean is no longer 0.
    """
    if isinstance(setting.scales, ScaleSpace):
        return setting.scales
    side = reference.shape[0]
    if setting.scales == "for_image":
        scales = ScaleSpace.for_image(side, side)
    else:
        widths = [1.0, 5.0, 15.0, 45.0]
        while 2.0 * widths[-1] <= WIDEST * side:
            widths.append(2.0 * widths[-1])
        scales = ScaleSpace(widths, widths if setting.scales == "every" else widths[1:], 0.125)
    return replace(scales, bounds=(min(0.0, float(reference.min())), max(1.0, float(reference.max()))))

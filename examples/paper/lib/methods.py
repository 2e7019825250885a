"""Objectives of the one-dimensional figures, and their values and gradients for batches of signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from examples.paper.figures.signals import Host
from examples.paper.lib.lpips import lpips
from loi_core import MSSSIM, GaussianPyramid, LOIObjective, PixelL2, ScaleSpace
from loi_core.method.blurs import Blur, gaussian_blur
from loi_core.objectives import Evaluation, ImageObjective, PlaneComparison, ReferencePlanes
from loi_core.support.arrays import Array, sum_of_all

__all__ = ["METHODS", "SIGMAS", "Comparison", "Method", "SigmaSpace", "sigma_method"]

SIGMAS: Final = ScaleSpace.paper("vector").sigma
BATCH_SIZE: Final = 64  # images of one comparison


class SigmaSpace(ImageObjective[float]):
    """Sum over inner scales of the mean squared difference of the blurred images, without histograms."""

    def __init__(self, reference: Array, sigmas: tuple[float, ...] = SIGMAS) -> None:
        super().__init__(reference)
        self._sigmas = sigmas

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[float]:
        """See :class:`loi_core.ImageObjective`."""
        planes = reference.planes
        height, width = planes.shape[-2:]
        blurs = {sigma: gaussian_blur(height, width, sigma, "reflect", like=planes) for sigma in self._sigmas}
        return _SigmaComparison({sigma: (blur, blur.apply(planes)) for sigma, blur in blurs.items()})


@dataclass(frozen=True, eq=False)
class _SigmaComparison(PlaneComparison[float]):
    """Comparison with the blur and the blurred reference of every sigma."""

    blurred: dict[float, tuple[Blur, Array]]

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[float]:
        weight = 1.0 / np.prod(planes.shape)
        differences = {sigma: blur.apply(planes) - reference for sigma, (blur, reference) in self.blurred.items()}
        terms = {sigma: sum_of_all(difference * difference) * weight for sigma, difference in differences.items()}
        if not gradient:
            return Evaluation(terms, None)
        slopes = [
            self.blurred[sigma][0].adjoint(difference * (2.0 * weight)) for sigma, difference in differences.items()
        ]
        return Evaluation(terms, sum(slopes[1:], slopes[0]))


@dataclass(frozen=True)
class Method:
    """A method of comparing images.

    Attributes
    ----------
    name : str
    make : callable
        Return the objective for a reference of shape (H, W, 1).
    signal_rows : int or None
        Number of equal rows that represent a signal, an image of one row; None for a square image. Under reflection
        equal rows change nothing, but pyramids, windows and networks need more than one.
    dtype : str
        Precision of the computation.
    """

    name: str
    make: Callable[[Host], ImageObjective[Any]]
    signal_rows: int | None = 1
    dtype: str = "float64"

    def against(self, reference: Host) -> Comparison:
        """Return the comparison of images with a reference of shape (H, W)."""
        height, width = reference.shape
        rows = (self.signal_rows or width) if height == 1 else 1
        return Comparison(self.make(_repeated(reference[None], rows, self.dtype)[0]), rows, self.dtype)


@dataclass(frozen=True)
class Comparison:
    """An objective of grey images, with every row of an image repeated `rows` times."""

    objective: ImageObjective[Any]
    rows: int
    dtype: str

    def values(self, images: Host) -> Host:
        """Return the objective of every image, shape (N,), for `images` of shape (N, H, W)."""
        return np.array([float(self.objective.value(image)) for image in _repeated(images, self.rows, self.dtype)])

    def gradients(self, images: Host) -> Host:
        """Return the gradient of the objective with respect to every image, shape (N, H, W)."""
        gradients = np.zeros(images.shape)
        for start in range(0, len(images), BATCH_SIZE):
            batch = images[start : start + BATCH_SIZE]
            gradient = self.objective.value_and_grad(_repeated(batch, self.rows, self.dtype))[1].astype(np.float64)
            # The objective averages over a batch, which divides the gradient of each image by the size of the batch.
            summed = gradient.reshape(*batch.shape[:2], self.rows, -1).sum(axis=2)
            gradients[start : start + BATCH_SIZE] = summed * len(batch)
        return gradients


def _repeated(images: Host, rows: int, dtype: str) -> Host:
    """Repeat every row of images of shape (N, H, W); return shape (N, H * rows, W, 1)."""
    return np.repeat(images, rows, axis=1)[..., None].astype(dtype)


def _for_image(reference: Host) -> LOIObjective:
    width = reference.shape[1]
    return LOIObjective(reference, ScaleSpace.for_image(width, width))


def sigma_method(sigma: float) -> Method:
    """Return the method that matches images at a single inner scale."""
    return Method(f"sigma {sigma:g}", lambda reference: SigmaSpace(reference, (sigma,)))


METHODS: Final = (
    Method("pixel L2", PixelL2),
    Method("Gaussian pyramid", GaussianPyramid, signal_rows=None),
    Method("MS-SSIM", MSSSIM, signal_rows=None),
    Method("LPIPS", lpips, signal_rows=32, dtype="float32"),
    Method("sigma only", SigmaSpace),
    sigma_method(15.0),
    sigma_method(45.0),
    Method("loi, paper", lambda reference: LOIObjective(reference, ScaleSpace.paper("vector"))),
    Method("loi, for_image", _for_image),
)

"""The objectives of the one-dimensional figures, and the slopes that each has on many signals at once."""

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
BATCH: Final = 64  # images that are compared at once


class SigmaSpace(ImageObjective[float]):
    """Matching in the inner scale space alone: mean squared differences of the images at every sigma, summed."""

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
    """By sigma, its blur and the blurred reference."""

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
    """One way of comparing images.

    Attributes
    ----------
    name : str
    make : callable
        From a reference, shape (H, W, 1), to an objective.
    least_rows : int or None
        What is shown to it of a signal, an image of one row: as many equal rows, or for None a square of them. Under
        reflection equal rows change nothing; pyramids, windows and networks cannot do with one.
    dtype : str
        That it computes in.
    """

    name: str
    make: Callable[[Host], ImageObjective[Any]]
    least_rows: int | None = 1
    dtype: str = "float64"

    def against(self, reference: Host) -> Comparison:
        """The method, ready to compare images with one of shape (H, W)."""
        height, width = reference.shape
        rows = (self.least_rows or width) if height == 1 else 1
        return Comparison(self.make(_repeated(reference[None], rows, self.dtype)[0]), rows, self.dtype)


@dataclass(frozen=True)
class Comparison:
    """An objective on grey images, each row of which it sees `rows` times."""

    objective: ImageObjective[Any]
    rows: int
    dtype: str

    def values(self, images: Host) -> Host:
        """The objective of every image, shape (N,); `images` has shape (N, H, W)."""
        return np.array([float(self.objective.value(one)) for one in _repeated(images, self.rows, self.dtype)])

    def gradients(self, images: Host) -> Host:
        """The gradient of every image's objective by that image, shape (N, H, W)."""
        found = np.zeros(images.shape)
        for start in range(0, len(images), BATCH):
            batch = images[start : start + BATCH]
            gradient = self.objective.value_and_grad(_repeated(batch, self.rows, self.dtype))[1].astype(np.float64)
            # A batch is averaged, so each image's own gradient comes divided by their number.
            summed = gradient.reshape(*batch.shape[:2], self.rows, -1).sum(axis=2)
            found[start : start + BATCH] = summed * len(batch)
        return found


def _repeated(images: Host, rows: int, dtype: str) -> Host:
    """Images, shape (N, H, W), with every row repeated, shape (N, H * rows, W, 1)."""
    return np.repeat(images, rows, axis=1)[..., None].astype(dtype)


def _for_image(reference: Host) -> LOIObjective:
    width = reference.shape[1]
    return LOIObjective(reference, ScaleSpace.for_image(width, width))


def sigma_method(sigma: float) -> Method:
    """Matching at one inner scale alone."""
    return Method(f"sigma {sigma:g}", lambda reference: SigmaSpace(reference, (sigma,)))


METHODS: Final = (
    Method("pixel L2", PixelL2),
    Method("Gaussian pyramid", GaussianPyramid, least_rows=None),
    Method("MS-SSIM", MSSSIM, least_rows=None),
    Method("LPIPS", lpips, least_rows=32, dtype="float32"),
    Method("sigma only", SigmaSpace),
    sigma_method(15.0),
    sigma_method(45.0),
    Method("loi, paper", lambda reference: LOIObjective(reference, ScaleSpace.paper("vector"))),
    Method("loi, for_image", _for_image),
)

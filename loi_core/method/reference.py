"""The loss and its gradient as a plain sum, in float64 on NumPy: dense matrices, every level, every pixel.

It shares the kernels, the levels and the rules with the library, and none of what makes the library fast: no rungs, no
blocks, no chunks, no level left out. What a backend gives is measured against it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.blurs import Blur, DenseBlur
from loi_core.method.distance import TIE_ROUNDINGS
from loi_core.method.gaussian import Matrix, blur_matrix
from loi_core.method.scales import Boundary, ScaleSpace
from loi_core.pixels.bounds import clip, clip_pullback
from loi_core.pixels.layout import Layout
from loi_core.support.arrays import Host

__all__ = ["DOUBLE", "Planes", "cost", "dense_blur", "direct", "slope_of_cost"]

DOUBLE: Final = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Planes:
    """Two images as planes, float64, shape (N, H, W).

    Attributes
    ----------
    layout : Layout
        Of the image.
    image, reference : array
        Where a pixel of either is not finite, both hold the reference, or 0.
    seen : array of bool
        Where both are finite.
    """

    layout: Layout
    image: Host
    reference: Host
    seen: Host

    @classmethod
    def of(cls, image: Host, reference: Host, channel_axis: int | None = -1) -> Planes:
        """The planes of an image and of a reference whose batch axes fit."""
        layout = Layout.of("image", image.shape, channel_axis)
        theirs = Layout.of("reference", reference.shape, channel_axis)
        wanted = layout.broadcast_planes("image", reference.astype(np.float64), theirs)
        planes = layout.to_planes(image.astype(np.float64))
        finite = np.isfinite(wanted)
        wanted = np.where(finite, wanted, 0.0)
        seen = np.isfinite(planes) & finite
        return cls(layout, np.where(seen, planes, wanted), wanted, seen)

    def equal(self) -> list[list[int]]:
        """Which planes are the same in both images, and so need to be looked at only once."""
        groups: dict[tuple[bytes, bytes], list[int]] = {}
        for index in range(len(self.image)):
            groups.setdefault((self.image[index].tobytes(), self.reference[index].tobytes()), []).append(index)
        return list(groups.values())


def direct(
    image: Host, reference: Host, scales: ScaleSpace, *, channel_axis: int | None = -1, eps: float = DOUBLE
) -> tuple[float, Host]:
    """Value, and gradient by the image, with every accuracy "exact".

    Parameters
    ----------
    image, reference : array, shape (*batch, H, W, C)
        Pixels that are not finite are masked.
    scales : ScaleSpace
        The scales to compare.
    channel_axis : int or None
        Where the channels are.
    eps : float
        Machine epsilon of the dtype whose tie rule holds; the arithmetic is float64 whatever it is.
    """
    planes = Planes.of(image, reference, channel_axis)
    value, gradient = 0.0, np.zeros_like(planes.image)
    for group in planes.equal():
        one, slopes = _plane(planes.image[group[0]], planes.reference[group[0]], scales, eps)
        value += one * len(group) / len(planes.image)
        gradient[group] = slopes / len(planes.image)
    return value, planes.layout.to_image(np.where(planes.seen, gradient, 0.0))


def dense_blur(shape: tuple[int, ...], scale: float, boundary: Boundary, taps: int | None) -> Blur:
    """A Gaussian blur of planes of this shape, as dense matrices; nothing at all if `scale` is 0."""
    if scale == 0.0:
        return _Same()
    rows, columns = (_matrix(size, scale, boundary, taps) for size in shape)
    return DenseBlur(rows, columns)


def cost(magnitude: Host, p: float, tie: float) -> Host:
    """``magnitude ** (1 / p)``, 0 where the magnitude is at most `tie`."""
    return np.where(magnitude > tie, magnitude if p == 1.0 else magnitude ** (1.0 / p), 0.0)


def slope_of_cost(magnitude: Host, p: float, tie: float) -> Host:
    """The derivative of :func:`cost`, 0 where the magnitude is at most `tie`."""
    if p == 1.0:
        return np.where(magnitude > tie, 1.0, 0.0)
    beyond = np.maximum(magnitude, tie)
    return np.where(magnitude > tie, beyond ** (1.0 / p - 1.0) / p, 0.0)


class _Same:
    """The blur that changes nothing."""

    def apply(self, planes: Host) -> Host:
        return planes

    def adjoint(self, planes: Host) -> Host:
        return planes


@functools.lru_cache(maxsize=16)
def _matrix(size: int, scale: float, boundary: Boundary, taps: int | None) -> Matrix:
    return blur_matrix(size, scale, boundary, taps)


def _plane(image: Host, reference: Host, scales: ScaleSpace, eps: float) -> tuple[float, Host]:
    shape = image.shape
    clipped, wanted = (clip(each, *scales.bounds) - scales.padding for each in (image, reference))
    value, gradient = 0.0, np.zeros(shape)
    for sigma in scales.sigma:
        inner = dense_blur(shape, sigma, scales.boundary, scales.inner_taps)
        intensity, target = inner.apply(clipped), inner.apply(wanted)
        for beta in scales.beta:
            mass = scales.mass(beta)
            tie = TIE_ROUNDINGS * eps * mass / scales.spacing(beta)
            weight = scales.scale_weight * scales.level_weight(beta) / image.size
            cdf, slope = _cdf_and_slope(intensity, scales, beta)
            difference = cdf - _cdf_and_slope(target, scales, beta)[0]
            for alpha in scales.alpha:
                extent = dense_blur(shape, alpha, scales.boundary, scales.extent_taps)
                mean = extent.apply(difference)
                size = np.abs(mean)
                value += weight * float(np.sum(cost(size, scales.p, tie)))
                pulled = extent.adjoint(np.sign(mean) * slope_of_cost(size, scales.p, tie))
                gradient += weight * inner.adjoint(np.sum(pulled * slope, axis=0))
    return value, clip_pullback(image, gradient, *scales.bounds)


def _cdf_and_slope(intensity: Host, scales: ScaleSpace, beta: float) -> tuple[Host, Host]:
    first, steps = scales.levels(beta)[0] - scales.padding, np.arange(scales.level_count(beta))[:, None, None]
    spacing = scales.spacing(beta)
    # In whole steps, since levels in units of intensity have a rounding each, which add up where there are thousands.
    offsets = (steps - (intensity - first) / spacing) * (spacing / beta)
    weights = np.exp(-0.5 * offsets**2) / (math.sqrt(2.0 * math.pi) * beta) * scales.mass(beta)
    return np.cumsum(weights, axis=0), np.cumsum(weights * offsets / beta, axis=0)

"""The whole method on one page: loss and gradient by brute force, in float64 on NumPy. Start reading here.

Dense matrices, every level, every pixel. Tests compare all fast implementations with this one. Only the
kernel (:mod:`loi_core.method.gaussian`) and the scales (:mod:`loi_core.method.scales`) are shared with the rest.

Equation numbers refer to the paper, *Locally Orderless Images for Optimization in Differentiable Rendering*.
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
from loi_core.pixels.layout import Layout
from loi_core.support.arrays import Host

__all__ = ["DOUBLE", "Planes", "cost", "dense_blur", "loss_and_gradient", "slope_of_cost"]

DOUBLE: Final = float(np.finfo(np.float64).eps)


def loss_and_gradient(
    image: Host,
    reference: Host,
    scales: ScaleSpace,
    *,
    channel_axis: int | None = -1,
    eps: float = DOUBLE,
    weights: Host | None = None,
) -> tuple[float, Host]:
    """Return the loss of an image and its gradient with respect to the image.

    Parameters
    ----------
    image, reference : array, shape (*batch, H, W, C)
        Pixels that are not finite are masked: they add nothing, and their gradient is 0.
    scales : ScaleSpace
        The scales to compare.
    channel_axis : int or None
        Axis of the channels.
    eps : float
        Machine epsilon for the tie rule; the arithmetic is float64 for any value.
    weights : array, shape (H, W), optional
        Weights of pixels in [0, 1]. Pixels of weight 0 are masked.

    Returns
    -------
    value : float
    gradient : array
        Of the image's shape, float64.
    """
    planes = Planes.of(image, reference, channel_axis, None if weights is None else weights > 0.0)
    w = np.ones(planes.image.shape[-2:]) if weights is None else weights
    value, gradient = 0.0, np.zeros_like(planes.image)
    for group in planes.equal_planes():
        plane_value, slopes = _plane(planes.image[group[0]], planes.reference[group[0]], w, scales, eps)
        value += plane_value * len(group) / len(planes.image)
        gradient[group] = slopes / len(planes.image)
    return value, planes.layout.to_image(np.where(planes.valid, gradient, 0.0))


def _plane(image: Host, reference: Host, w: Host, scales: ScaleSpace, eps: float) -> tuple[float, Host]:
    """Evaluate one channel of one image, shape (H, W), in the paper's notation."""
    I, I_gt = (scales.intensity_range.apply(plane) - scales.padding for plane in (image, reference))
    value, gradient = 0.0, np.zeros(image.shape)
    for sigma in scales.sigma:
        G = dense_blur(image.shape, sigma, scales.boundary, scales.inner_taps)
        J, J_gt = G.apply(I), G.apply(I_gt)  # eq. 1: the image at inner scale sigma
        for beta in scales.beta:
            # Eq. 3: each pixel becomes a histogram P(k) = N(k; J, beta^2) over levels k, accumulated over k.
            cdf, dcdf_dJ = _cdf_and_slope(J, scales, beta)  # shape (L, H, W) both
            cdf_gt, _ = _cdf_and_slope(J_gt, scales, beta)
            weight = scales.scale_weight * scales.level_weight(beta) / image.size  # of one level at one pixel
            tie = TIE_ROUNDINGS * eps * scales.mass(beta) / scales.spacing(beta)
            for alpha in scales.alpha:
                # Eq. 4: histograms are averaged over a neighbourhood, H = A_alpha * P. A acts on pixels and
                # accumulation on levels, so they commute: A is applied to the difference of the CDFs.
                A = dense_blur(image.shape, alpha, scales.boundary, scales.extent_taps)
                # A pixel contributes to the histograms around it with its weight, 1 in the paper.
                F = A.apply(w * _centred(cdf - cdf_gt, w, scales))
                # Eq. 5: E(alpha, beta, sigma), the mean over pixels of the sum over levels of |F|^(1/p) dk.
                value += weight * float(np.sum(cost(np.abs(F), scales.p, tie)))
                # The chain rule in reverse. A blur is a matrix; its adjoint is the transposed matrix.
                dE_dF = weight * np.sign(F) * slope_of_cost(np.abs(F), scales.p, tie)  # eq. 5
                dE_dcdf = w * _centred(A.adjoint(dE_dF), w, scales)  # eq. 4
                dE_dJ = np.sum(dE_dcdf * dcdf_dJ, axis=0)  # eq. 3
                gradient += G.adjoint(dE_dJ)  # eq. 1
    slopes: Host = scales.intensity_range.pullback(image, gradient)  # intensities beyond the bounds are compressed
    return value, slopes


def _centred(stack: Host, w: Host, scales: ScaleSpace) -> Host:
    """Return a stack, shape (L, H, W), less its weighted mean over pixels if the scales are centred.

    The map x -> w * _centred(x) is symmetric, so the chain rule in reverse applies it again.
    """
    if not scales.centred:
        return stack
    centred: Host = stack - np.sum(w * stack, axis=(1, 2), keepdims=True) / (np.sum(w) or 1.0)
    return centred


def _cdf_and_slope(intensity: Host, scales: ScaleSpace, beta: float) -> tuple[Host, Host]:
    """Return eq. 3, accumulated over levels, and its derivative by the intensity; both of shape (L, H, W)."""
    spacing, count = scales.spacing(beta), scales.level_count(beta)
    first, steps = scales.levels(beta)[0] - scales.padding, np.arange(count)[:, None, None]
    # In integer steps, because the rounding errors of thousands of levels in units of intensity would accumulate.
    offsets = (steps - (intensity - first) / spacing) * (spacing / beta)  # (k - J) / beta
    histogram = np.exp(-0.5 * offsets**2) / (math.sqrt(2.0 * math.pi) * beta) * scales.mass(beta)
    return np.cumsum(histogram, axis=0), np.cumsum(histogram * offsets / beta, axis=0)


def cost(magnitude: Host, p: float, tie: float) -> Host:
    """Return ``magnitude ** (1 / p)`` of eq. 5, 0 where the magnitude is at most `tie`, the rounding error."""
    return np.where(magnitude > tie, magnitude if p == 1.0 else magnitude ** (1.0 / p), 0.0)


def slope_of_cost(magnitude: Host, p: float, tie: float) -> Host:
    """Return the derivative of :func:`cost`, 0 where the magnitude is at most `tie`."""
    if p == 1.0:
        return np.where(magnitude > tie, 1.0, 0.0)
    at_least_tie = np.maximum(magnitude, tie)
    return np.where(magnitude > tie, at_least_tie ** (1.0 / p - 1.0) / p, 0.0)


def dense_blur(shape: tuple[int, ...], scale: float, boundary: Boundary, taps: int | None) -> Blur:
    """Return eq. 2 as matrices: a Gaussian blur along rows and columns of planes; the identity if `scale` is 0."""
    if scale == 0.0:
        return _Identity()
    rows, columns = (_matrix(size, scale, boundary, taps) for size in shape)
    return DenseBlur(rows, columns)


class _Identity:
    """The blur of scale 0."""

    def apply(self, planes: Host) -> Host:
        return planes

    def adjoint(self, planes: Host) -> Host:
        return planes


@functools.lru_cache(maxsize=16)
def _matrix(size: int, scale: float, boundary: Boundary, taps: int | None) -> Matrix:
    return blur_matrix(size, scale, boundary, taps)


@dataclass(frozen=True)
class Planes:
    """Two images as planes, float64, shape (N, H, W).

    Attributes
    ----------
    layout : Layout
        Layout of the image.
    image, reference : array
        Where a pixel of either is not finite, both hold the reference, or 0.
    valid : array of bool
        True where both are finite and unmasked.
    """

    layout: Layout
    image: Host
    reference: Host
    valid: Host

    @classmethod
    def of(cls, image: Host, reference: Host, channel_axis: int | None = -1, mask: Host | None = None) -> Planes:
        """Return the planes of an image and of a reference with matching batch axes; `mask` has shape (H, W)."""
        layout = Layout.of("image", image.shape, channel_axis)
        reference_layout = Layout.of("reference", reference.shape, channel_axis)
        target = layout.broadcast_planes(reference.astype(np.float64), reference_layout)
        planes = layout.to_planes(image.astype(np.float64))
        finite = np.isfinite(target)
        target = np.where(finite, target, 0.0)
        valid = np.isfinite(planes) & finite & (True if mask is None else mask)
        return cls(layout, np.where(valid, planes, target), target, valid)

    def equal_planes(self) -> list[list[int]]:
        """Return groups of planes that are equal in both images, each evaluated only once."""
        groups: dict[tuple[bytes, bytes], list[int]] = {}
        for index in range(len(self.image)):
            groups.setdefault((self.image[index].tobytes(), self.reference[index].tobytes()), []).append(index)
        return list(groups.values())

"""Bounds on the rounding error of a loss and its gradient: a running error analysis, pixel by pixel, in float64.

Every step of the evaluation bounds the error of its output from the roundings that IEEE arithmetic allows and from the
error of its input. No constant is measured:

* An operation has an error of eps / 2, an exponential an error of 2 eps plus the error of its argument.
* A sum of n terms, in any order, has an error of at most n eps / 2 times the sum of their magnitudes. A term smaller
  than half an ulp of the partial sum has an error of at most its own magnitude, so the terms of a Gaussian beyond its
  radius add no error.
* Both images pass through the same operations. Where they are equal within the support of the inner kernel, their
  histograms are equal to the bit; only elsewhere does their difference have an error.
* The derivative of the cost is a sign, or steep. Its range is determined over all differences that rounding allows,
  with the tie rule: 0 wherever the difference may count as a tie.

Where differences are close to the tie threshold (large flat regions, histograms that agree), the last point makes the
bound as large as the gradient itself: there no dtype can determine the direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.blurs import Blur
from loi_core.method.distance import TIE_ROUNDINGS
from loi_core.method.gaussian import truncation
from loi_core.method.reference import DOUBLE, Planes, cost, dense_blur, slope_of_cost
from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import Host
from loi_core.support.keywords import suggest_keywords

__all__ = ["Allowed", "allowed"]

PYRAMID_ROUNDINGS: Final = 32.0
"""Roundings of a pyramid in addition to one dense matrix: it ends in a kernel of some 25 cells along each axis."""

BLOCK_LENGTH: Final = 32
"""Largest number of entries that a library adds in sequence along one axis before it adds the sums (`sum_of_all`)."""

MEAN_ROUNDINGS: Final = float(BLOCK_LENGTH)
"""Roundings of a mean over pixels: half of a block's length along each axis."""

POWER_ROUNDINGS: Final = 4.0
"""Roundings of a power: its logarithm, its exponential and their product."""


@dataclass(frozen=True)
class Allowed:
    """Largest differences from the plain sum in float64.

    Attributes
    ----------
    loss : float
        Bound on the error of the loss.
    gradient : array
        Bound on the error of the gradient for each pixel, of the image's shape.
    """

    loss: float
    gradient: Host

    @property
    def norm(self) -> float:
        """Bound on the error of the gradient in the 1-norm."""
        return float(np.sum(self.gradient))


@suggest_keywords
def allowed(
    image: Host, reference: Host, scales: ScaleSpace, eps: float, *, channel_axis: int | None = -1, shift: float = 0.0
) -> Allowed:
    """Return the largest rounding errors in the dtype with machine epsilon `eps`.

    Parameters
    ----------
    image, reference : array, shape (*batch, H, W, C)
        The images as the backend sees them, rounded to its dtype. Pixels that are not finite are masked.
    scales : ScaleSpace
        The scales to compare.
    eps : float
        Machine epsilon of the arithmetic, which also defines the tie rule.
    channel_axis : int or None
        Axis of the channels.
    shift : float
        Error of the intensities from a tone curve, in units of eps.

    Returns
    -------
    Allowed
        Bounds that include the error of the plain sum itself, which is computed in float64.
    """
    planes = Planes.of(image, reference, channel_axis)
    loss, gradient = 0.0, np.zeros_like(planes.image)
    count = len(planes.image)
    for group in planes.equal_planes():
        plane = _Plane(planes.image[group[0]], planes.reference[group[0]], scales, eps, count, shift)
        plane_loss, slopes = plane.bounds()
        loss += plane_loss * len(group) / count
        gradient[group] = slopes / count
    factor = 1.0 + DOUBLE / eps
    return Allowed(factor * loss, factor * planes.layout.to_image(np.where(planes.valid, gradient, 0.0)))


@dataclass(frozen=True)
class _Histogram:
    """A stack of CDFs and its slopes, shape (L, H, W), each with an error bound."""

    cdf: Host
    cdf_error: Host
    slope: Host
    slope_error: Host


@dataclass(frozen=True)
class _Plane:
    image: Host
    reference: Host
    scales: ScaleSpace
    eps: float
    planes: int
    shift: float

    def bounds(self) -> tuple[float, Host]:
        """Return the errors of the value and of the gradient at each pixel."""
        scales, eps, shape = self.scales, self.eps, self.image.shape
        compressed, reference = (
            scales.intensity_range.apply(plane) - scales.padding for plane in (self.image, self.reference)
        )
        loss, gradient = 0.0, np.zeros(shape)
        for sigma in scales.sigma:
            inner = dense_blur(shape, sigma, scales.boundary, scales.inner_taps)
            roundings = self._blur_roundings(sigma, scales.inner_taps, pyramid=0.0)
            intensity, target = (self._blurred(inner, plane, roundings) for plane in (compressed, reference))
            differs = inner.apply(np.where(compressed == reference, 0.0, 1.0)) > 0.0
            for beta in scales.beta:
                histogram, expected = self._histogram(*intensity, beta), self._histogram(*target, beta)
                error, slope, slope_error = self._compared(histogram, expected, differs, beta)
                loss += error
                gradient += inner.adjoint(slope_error) + eps * (roundings + 2.0) * inner.adjoint(np.abs(slope))
        return loss, gradient

    def _blur_roundings(self, scale: float, taps: int | None, pyramid: float) -> float:
        """Return the error of a blur in units of eps times the blurred magnitudes."""
        if scale == 0.0:
            return 0.0
        kernel = 2.0 * truncation(self.eps) * scale + 1.0 if taps is None else float(taps)
        return pyramid + math.fsum(0.5 * min(size, kernel) + 2.0 for size in self.image.shape)

    def _blurred(self, inner: Blur, plane: Host, roundings: float) -> tuple[Host, Host]:
        blurred = inner.apply(plane)
        return blurred, self.eps * (roundings * inner.apply(np.abs(plane)) + np.abs(blurred) + self.shift)

    def _histogram(self, intensity: Host, error: Host, beta: float) -> _Histogram:
        """Return the histograms of intensities with this error, which shifts all levels of a histogram alike."""
        eps, levels = self.eps, self.scales.levels(beta) - self.scales.padding
        above = intensity - levels[0]
        shift = (error + 0.5 * eps * abs(levels[0]) + 1.5 * eps * np.abs(above)) / beta
        spacing = self.scales.spacing(beta)
        offsets = (np.arange(len(levels))[:, None, None] - above / spacing) * (spacing / beta)
        max_offset, min_offset = np.abs(offsets) + shift, np.maximum(np.abs(offsets) - shift, 0.0)
        log = math.log(self.scales.mass(beta) / (math.sqrt(2.0 * math.pi) * beta))
        weights, max_weights = np.exp(log - 0.5 * offsets**2), np.exp(log - 0.5 * min_offset**2)
        # Errors of the offset, its square, the argument and `exp`.
        weight_error = eps * max_weights * (2.0 * max_offset**2 + abs(log) + 2.0)
        cdf, slope = np.cumsum(weights, axis=0), np.cumsum(weights * offsets, axis=0)
        cdf_error = shift * np.abs(slope) + np.cumsum(
            0.5 * shift**2 * max_weights * (max_offset**2 + 1.0) + weight_error + np.minimum(eps * cdf, max_weights),
            axis=0,
        )
        curvature = np.abs(np.cumsum(weights * (offsets**2 - 1.0), axis=0))
        slope_error = shift * curvature + np.cumsum(
            0.5 * shift**2 * max_weights * (max_offset**3 + 3.0 * max_offset)
            + max_offset * (weight_error + 3.0 * eps * max_weights)
            + np.minimum(eps * np.abs(slope), max_weights * max_offset),
            axis=0,
        )
        return _Histogram(cdf, cdf_error, slope / beta, slope_error / beta)

    def _compared(
        self, histogram: _Histogram, expected: _Histogram, differs: Host, beta: float
    ) -> tuple[float, Host, Host]:
        """Return the error of the value, the cotangent of the blurred image, shape (H, W), and its error."""
        scales, eps = self.scales, self.eps
        tie = TIE_ROUNDINGS * eps * scales.mass(beta) / scales.spacing(beta)
        weight = scales.scale_weight * scales.level_weight(beta) / self.image.size
        difference = histogram.cdf - expected.cdf
        size = np.abs(difference)
        difference_error = np.where(differs, histogram.cdf_error + expected.cdf_error + eps * size, 0.0)
        if scales.centred:
            difference, difference_error = self._centred(difference, difference_error)
            size = np.abs(difference)
        loss, pulled, pulled_error = 0.0, np.zeros_like(size), np.zeros_like(size)
        for alpha in scales.alpha:
            extent = dense_blur(self.image.shape, alpha, scales.boundary, scales.extent_taps)
            roundings = self._blur_roundings(alpha, scales.extent_taps, PYRAMID_ROUNDINGS)
            mean = extent.apply(difference)
            # A kernel is cut where it is below eps / 2 of its peak; the plain sum includes its tail.
            tail = eps * float(size.max()) if alpha else 0.0
            mean_error = extent.apply(difference_error) + eps * roundings * extent.apply(size) + tail
            loss += self._cost_error(np.abs(mean), mean_error, tie)
            slope = np.sign(mean) * slope_of_cost(np.abs(mean), scales.p, tie)
            slope_error = _slope_error(np.abs(mean), mean_error, scales.p, tie) + POWER_ROUNDINGS * eps * np.abs(slope)
            pulled += extent.adjoint(slope)
            pulled_error += extent.adjoint(slope_error) + eps * (roundings + 2.0) * extent.adjoint(np.abs(slope))
        if scales.centred:
            pulled, pulled_error = self._centred(pulled, pulled_error)
        slopes, slopes_error = histogram.slope, histogram.slope_error
        sum_error = eps * (0.5 * len(size) + 3.0) * np.abs(pulled * slopes)
        error = pulled_error * (np.abs(slopes) + slopes_error) + np.abs(pulled) * slopes_error + sum_error
        return weight * loss, weight * np.sum(pulled * slopes, axis=0), weight * np.sum(error, axis=0)

    def _centred(self, stack: Host, error: Host) -> tuple[Host, Host]:
        """Return a stack, shape (L, H, W), less its means over pixels, and its error."""
        centred = stack - np.mean(stack, axis=(1, 2), keepdims=True)
        mean_error = np.mean(error + MEAN_ROUNDINGS * self.eps * np.abs(stack), axis=(1, 2), keepdims=True)
        return centred, error + mean_error + self.eps * np.abs(centred)

    def _cost_error(self, size: Host, size_error: Host, tie: float) -> float:
        """Return the error of the sum of costs: of each cost, and of their addition."""
        largest, middle, smallest = (
            cost(value, self.scales.p, tie) for value in (size + size_error, size, np.maximum(size - size_error, 0.0))
        )
        axes = (*size.shape, self.planes)
        passes = sum(math.ceil(math.log(max(length, 2), BLOCK_LENGTH)) for length in axes)
        roundings = 0.5 * BLOCK_LENGTH * passes + POWER_ROUNDINGS + len(self.scales.keys)
        cost_errors = np.maximum(largest - middle, middle - smallest)
        return float(np.sum(cost_errors)) + roundings * self.eps * float(np.sum(middle))


def _slope_error(size: Host, size_error: Host, p: float, tie: float) -> Host:
    """Return the largest change of the cost's derivative if |difference| = `size` has the error `size_error`."""
    slope = slope_of_cost(size, p, tie)
    low, high = np.maximum(size - size_error, 0.0), size + size_error
    beyond_tie = np.nextafter(tie, math.inf)
    steeper = slope_of_cost(np.maximum(low, beyond_tie), p, tie)
    error = np.maximum(np.abs(steeper - slope), np.abs(slope_of_cost(high, p, tie) - slope))
    error = np.where(low <= tie, np.maximum(error, slope), error)
    # The difference may also have the opposite sign, beyond the tie threshold there.
    opposite = slope_of_cost(np.maximum(size_error - size, 0.0), p, tie)
    steepest = np.maximum(opposite, slope_of_cost(beyond_tie, p, tie))
    error = np.where(size_error - size > tie, np.maximum(error, slope + steepest), error)
    return np.where(high <= tie, 0.0, error)

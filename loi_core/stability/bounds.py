"""How far rounding may take a loss and its gradient from the plain sum: a running error analysis, pixel by pixel.

Every step of the evaluation gets a bound on what it hands on, in float64, from the roundings that IEEE arithmetic
allows it and from what it was handed. No constant is measured:

* An operation is off by eps / 2, an exponential by 2 eps and by what its argument is off.
* A sum of n terms, whatever their order, is off by at most n eps / 2 of the sum of their sizes. A term that is smaller
  than half an ulp of what it is added to is off by itself at the most, so the terms of a Gaussian beyond its reach
  cost nothing.
* Both images pass through the same operations. Where they are equal, as far as the inner kernel sees, so are their
  histograms, to the bit; only elsewhere is their difference off.
* The derivative of the cost is a sign, or steep. What it may be is found over the whole range of differences that
  rounding leaves open, with the tie rule: 0 wherever the difference may count as a tie.

Where differences are close to the tie threshold (large flat parts, histograms that agree) the last point makes the
bound as large as the gradient itself: there no dtype can tell which way to go, and the bound says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.method.blurs import Blur
from loi_core.method.distance import TIE_ROUNDINGS
from loi_core.method.gaussian import reach
from loi_core.method.reference import DOUBLE, Planes, cost, dense_blur, slope_of_cost
from loi_core.method.scales import ScaleSpace
from loi_core.pixels.bounds import clip
from loi_core.support.arrays import Host

__all__ = ["Allowed", "allowed"]

RUNGS: Final = 32.0
"""Roundings of a blur beyond those of one dense matrix: a cascade ends in a kernel of some 25 cells along each axis."""

BLOCK: Final = 32
"""Most entries that a library adds one after another along one axis before it adds such sums (see `sum_of_all`)."""

POWER: Final = 4.0
"""Roundings of a power: its logarithm, its exponential and their product."""


@dataclass(frozen=True)
class Allowed:
    """Largest differences from the plain sum in float64.

    Attributes
    ----------
    loss : float
        Of the value.
    gradient : array
        Of the gradient, by pixel: of the image's shape.
    """

    loss: float
    gradient: Host

    @property
    def norm(self) -> float:
        """Of the gradient, in the 1-norm."""
        return float(np.sum(self.gradient))


def allowed(
    image: Host, reference: Host, scales: ScaleSpace, eps: float, *, channel_axis: int | None = -1, shift: float = 0.0
) -> Allowed:
    """What rounding may change in the dtype with machine epsilon `eps`.

    Parameters
    ----------
    image, reference : array, shape (*batch, H, W, C)
        As the backend sees them, that is, rounded to its dtype already. Pixels that are not finite are masked.
    scales : ScaleSpace
        The scales to compare.
    eps : float
        Machine epsilon of the dtype that is computed in; the tie rule is that dtype's.
    channel_axis : int or None
        Where the channels are.
    shift : float
        By how many eps the intensities are off already, from a tone curve.

    Returns
    -------
    Allowed
        With what the plain sum, which is computed in float64 itself, may be off.
    """
    planes = Planes.of(image, reference, channel_axis)
    loss, gradient = 0.0, np.zeros_like(planes.image)
    count = len(planes.image)
    for group in planes.equal():
        one, slopes = _Plane(planes.image[group[0]], planes.reference[group[0]], scales, eps, count, shift).bounds()
        loss += one * len(group) / count
        gradient[group] = slopes / count
    share = 1.0 + DOUBLE / eps
    return Allowed(share * loss, share * planes.layout.to_image(np.where(planes.seen, gradient, 0.0)))


@dataclass(frozen=True)
class _Histogram:
    """A stack of CDFs and its slopes, shape (L, H, W), each with its error."""

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
        """Errors of the value and, by pixel, of the gradient."""
        scales, eps, shape = self.scales, self.eps, self.image.shape
        clipped, wanted = (clip(each, *scales.bounds) - scales.padding for each in (self.image, self.reference))
        loss, gradient = 0.0, np.zeros(shape)
        for sigma in scales.sigma:
            inner = dense_blur(shape, sigma, scales.boundary, scales.inner_taps)
            roundings = self._blur_roundings(sigma, scales.inner_taps, pyramid=0.0)
            intensity, target = (self._blurred(inner, each, roundings) for each in (clipped, wanted))
            touched = inner.apply(np.where(clipped == wanted, 0.0, 1.0)) > 0.0
            for beta in scales.beta:
                ours, theirs = self._histogram(*intensity, beta), self._histogram(*target, beta)
                error, pulled, pulled_error = self._compared(ours, theirs, touched, beta)
                loss += error
                gradient += inner.adjoint(pulled_error) + eps * (roundings + 2.0) * inner.adjoint(np.abs(pulled))
        return loss, gradient

    def _blur_roundings(self, scale: float, taps: int | None, pyramid: float) -> float:
        """By how many eps of the blurred sizes a blur is off."""
        if scale == 0.0:
            return 0.0
        kernel = 2.0 * reach(self.eps) * scale + 1.0 if taps is None else float(taps)
        return pyramid + math.fsum(0.5 * min(size, kernel) + 2.0 for size in self.image.shape)

    def _blurred(self, inner: Blur, plane: Host, roundings: float) -> tuple[Host, Host]:
        blurred = inner.apply(plane)
        return blurred, self.eps * (roundings * inner.apply(np.abs(plane)) + np.abs(blurred) + self.shift)

    def _histogram(self, intensity: Host, error: Host, beta: float) -> _Histogram:
        """Histograms of intensities that are off by `error`, each by one shift that all levels see alike."""
        eps, levels = self.eps, self.scales.levels(beta) - self.scales.padding
        above = intensity - levels[0]
        shift = (error + 0.5 * eps * abs(levels[0]) + 1.5 * eps * np.abs(above)) / beta
        spacing = self.scales.spacing(beta)
        offsets = (np.arange(len(levels))[:, None, None] - above / spacing) * (spacing / beta)
        most_away, least_away = np.abs(offsets) + shift, np.maximum(np.abs(offsets) - shift, 0.0)
        log = math.log(self.scales.mass(beta) / (math.sqrt(2.0 * math.pi) * beta))
        weights, most = np.exp(log - 0.5 * offsets**2), np.exp(log - 0.5 * least_away**2)
        off = eps * most * (2.0 * most_away**2 + abs(log) + 2.0)  # of the offset, its square, the argument, `exp`
        cdf, slope = np.cumsum(weights, axis=0), np.cumsum(weights * offsets, axis=0)
        cdf_off = shift * np.abs(slope) + np.cumsum(
            0.5 * shift**2 * most * (most_away**2 + 1.0) + off + np.minimum(eps * cdf, most), axis=0
        )
        bend = np.abs(np.cumsum(weights * (offsets**2 - 1.0), axis=0))
        slope_off = shift * bend + np.cumsum(
            0.5 * shift**2 * most * (most_away**3 + 3.0 * most_away)
            + most_away * (off + 3.0 * eps * most)
            + np.minimum(eps * np.abs(slope), most * most_away),
            axis=0,
        )
        return _Histogram(cdf, cdf_off, slope / beta, slope_off / beta)

    def _compared(self, ours: _Histogram, theirs: _Histogram, touched: Host, beta: float) -> tuple[float, Host, Host]:
        """Error of the value; the cotangent by the blurred image, and its error; shape (H, W) both."""
        scales, eps = self.scales, self.eps
        tie = TIE_ROUNDINGS * eps * scales.mass(beta) / scales.spacing(beta)
        weight = scales.scale_weight * scales.level_weight(beta) / self.image.size
        difference = ours.cdf - theirs.cdf
        size = np.abs(difference)
        off = np.where(touched, ours.cdf_error + theirs.cdf_error + eps * size, 0.0)
        loss, pulled, pulled_off = 0.0, np.zeros_like(size), np.zeros_like(size)
        for alpha in scales.alpha:
            extent = dense_blur(self.image.shape, alpha, scales.boundary, scales.extent_taps)
            roundings = self._blur_roundings(alpha, scales.extent_taps, RUNGS)
            mean = extent.apply(difference)
            # A kernel ends where it is below eps / 2 of its peak; beyond, the plain sum goes on.
            end = eps * float(size.max()) if alpha else 0.0
            mean_off = extent.apply(off) + eps * roundings * extent.apply(size) + end
            loss += self._cost_error(np.abs(mean), mean_off, tie)
            slope = np.sign(mean) * slope_of_cost(np.abs(mean), scales.p, tie)
            slope_off = _slope_error(np.abs(mean), mean_off, scales.p, tie) + POWER * eps * np.abs(slope)
            pulled += extent.adjoint(slope)
            pulled_off += extent.adjoint(slope_off) + eps * (roundings + 2.0) * extent.adjoint(np.abs(slope))
        added = eps * (0.5 * len(size) + 3.0) * np.abs(pulled * ours.slope)
        error = pulled_off * (np.abs(ours.slope) + ours.slope_error) + np.abs(pulled) * ours.slope_error + added
        return (weight * loss, weight * np.sum(pulled * ours.slope, axis=0), weight * np.sum(error, axis=0))

    def _cost_error(self, size: Host, off: Host, tie: float) -> float:
        """Error of the sum of costs: of each of them, and of adding them up."""
        most, usual, least = (
            cost(each, self.scales.p, tie) for each in (size + off, size, np.maximum(size - off, 0.0))
        )
        axes = (*size.shape, self.planes)
        passes = sum(math.ceil(math.log(max(length, 2), BLOCK)) for length in axes)
        roundings = 0.5 * BLOCK * passes + POWER + len(self.scales.keys)
        return float(np.sum(np.maximum(most - usual, usual - least))) + roundings * self.eps * float(np.sum(usual))


def _slope_error(size: Host, off: Host, p: float, tie: float) -> Host:
    """By how much the derivative of the cost may change if |difference| = `size` is off by `off`."""
    slope = slope_of_cost(size, p, tie)
    low, high = np.maximum(size - off, 0.0), size + off
    just_beyond = slope_of_cost(np.maximum(low, np.nextafter(tie, math.inf)), p, tie)
    error = np.maximum(np.abs(just_beyond - slope), np.abs(slope_of_cost(high, p, tie) - slope))
    error = np.where(low <= tie, np.maximum(error, slope), error)
    # The difference may also have the other sign, beyond the tie there.
    first = slope_of_cost(np.nextafter(tie, math.inf), p, tie)
    steepest = np.maximum(slope_of_cost(np.maximum(off - size, 0.0), p, tie), first)
    error = np.where(off - size > tie, np.maximum(error, slope + steepest), error)
    return np.where(high <= tie, 0.0, error)

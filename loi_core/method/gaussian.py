"""One-dimensional Gaussian blurs between samplings of one axis, as matrices in float64.

A blur of a finite axis is a linear map. Its matrix can hold any boundary rule, and the transpose is the exact adjoint.
Neither inputs nor outputs need lie on the pixels. A Gaussian after a Gaussian is a Gaussian, so a wide blur may pass
through coarser samplings and still be exact to rounding (:func:`coarsest_spacing`). Two-dimensional Gaussians are
products of two of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.method.scales import Boundary
from loi_core.support.cache import Cache

__all__ = [
    "MATRICES",
    "AxisBlur",
    "AxisGrid",
    "Matrix",
    "blur_matrix",
    "coarsest_spacing",
    "equivalent_scale",
    "pyramid_variance",
    "truncation",
]

Matrix: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

MIN_FLAT_SCALE: Final = 2.7
"""Scale, in axis lengths, from which a reflected Gaussian is constant to 2 exp(-(pi MIN_FLAT_SCALE)**2 / 2) < 1e-15."""

MIN_SERIES_SCALE: Final = 0.5
"""Scale, in axis lengths, from which a reflected Gaussian is summed as a cosine series."""

MIN_SMOOTH_SCALE: Final = 2.0
"""Scale, in samples, from which a Gaussian's sum is its integral, to 2 exp(-2 (pi MIN_SMOOTH_SCALE)**2) < 1e-33."""

VARIANCE_FACTOR: Final = 4.0 / 3.0
"""Variance of a pyramid level, in squared spacings and in units of :func:`_min_variance`."""


def truncation(eps: float) -> float:
    """Return the distance, in standard deviations, beyond which a Gaussian is below `eps` / 2 of its peak."""
    return math.sqrt(2.0 * math.log(2.0 / eps))


@dataclass(frozen=True)
class AxisGrid:
    """A uniform sampling of an axis: the centres of equal cells that cover all of its pixels.

    Attributes
    ----------
    size : int
        Number of pixels. They lie at 0, 1, ..., size - 1; the axis extends from -0.5 to size - 0.5.
    cells : int
        Number of samples; `size` samples are the pixels themselves.
    """

    size: int
    cells: int

    @property
    def spacing(self) -> float:
        """Distance between two samples, in pixels."""
        return self.size / self.cells

    @property
    def positions(self) -> Matrix:
        """Positions of the samples in pixels, shape (cells,)."""
        centres: Matrix = (np.arange(self.cells, dtype=np.float64) + 0.5) * self.spacing - 0.5
        return centres

    def __str__(self) -> str:
        return str(self.cells)


@dataclass(frozen=True)
class AxisBlur:
    """A Gaussian blur from one sampling of an axis to another.

    Attributes
    ----------
    source, target : AxisGrid
        Samplings of the same axis.
    scale : float
        Standard deviation in pixels; 0 is the identity and needs `target` to be `source`.
    boundary : {"reflect", "zero"}
        "reflect" mirrors about the edge of the first and last pixel (half-sample symmetric), any number of times:
        rows sum to 1, and columns too if the samplings are equal. "zero" pads with zeros.
    taps : int, optional
        Odd length at which the kernel is truncated before it is normalised; needs `source` to be the pixels.
    truncate : float
        Truncation without `taps`, in standard deviations.
    """

    source: AxisGrid
    target: AxisGrid
    scale: float
    boundary: Boundary
    taps: int | None = None
    truncate: float = truncation(float(np.finfo(np.float64).eps))

    @property
    def is_identity(self) -> bool:
        """Whether the blur changes nothing."""
        return self.scale == 0.0

    @property
    def is_symmetric(self) -> bool:
        """Whether the matrix equals its transpose."""
        return self.source == self.target

    @property
    def radius(self) -> float:
        """Radius of the kernel in pixels."""
        if self.taps is not None:
            return float(self.taps // 2)
        if self._is_wide:
            return math.inf
        return self.truncate * self.scale

    def matrix(self) -> Matrix:
        """Return the matrix, shape (target.cells, source.cells)."""
        return self.entries(range(self.target.cells), range(self.source.cells))

    def entries(self, rows: range, columns: range) -> Matrix:
        """Return a contiguous part of the matrix, shape (len(rows), len(columns))."""
        targets = self.target.positions[rows.start : rows.stop, None]
        sources = self.source.positions[None, columns.start : columns.stop]
        if self.taps is None:
            return self._weights(targets, sources)
        # A truncated kernel may end in a step; its values between two pixels are interpolated.
        left, right = np.floor(targets), np.ceil(targets)
        fraction = targets - left
        return (1.0 - fraction) * self._weights(left, sources) + fraction * self._weights(right, sources)

    def columns_of(self, rows: range) -> range:
        """Return the columns outside which these rows of the matrix are 0."""
        return self._support(self.target, rows, self.source)

    def rows_of(self, columns: range) -> range:
        """Return the rows outside which these columns of the matrix are 0."""
        return self._support(self.source, columns, self.target)

    @property
    def _is_wide(self) -> bool:
        return self.boundary == "reflect" and self.taps is None and self.scale >= MIN_SERIES_SCALE * self.source.size

    def _support(self, grid: AxisGrid, indices: range, target: AxisGrid) -> range:
        radius = self.radius + (1.0 if self.taps is not None else 0.0)
        if math.isinf(radius):
            return range(target.cells)
        left = float(grid.positions[indices.start]) - radius
        right = float(grid.positions[indices.stop - 1]) + radius
        if self.boundary == "reflect":
            # Samples beyond an edge are mirrored.
            left, right = min(left, 2 * grid.size - 1 - right), max(right, -1 - left)
        first = math.ceil((left + 0.5) / target.spacing - 0.5 - 1e-9)
        last = math.floor((right + 0.5) / target.spacing - 0.5 + 1e-9)
        return range(min(max(first, 0), target.cells - 1), min(max(last + 1, 1), target.cells))

    def _weights(self, targets: Matrix, sources: Matrix) -> Matrix:
        if self.is_identity:
            return np.where(targets == sources, 1.0, 0.0)
        if self._is_wide:
            return self._series(targets, sources)
        weights = self._gaussian(targets - sources)
        if self.boundary == "reflect":
            # A mirrored axis repeats with period 2 size; each sample counts directly and mirrored.
            period = 2 * self.source.size
            mirrored = targets + sources + 1.0
            weights = weights + self._gaussian(mirrored)
            for multiple in range(1, math.ceil((self.radius + 1.0) / period) + 1):
                for shift in (-multiple * period, multiple * period):
                    weights = weights + self._gaussian(targets - sources + shift) + self._gaussian(mirrored + shift)
        with np.errstate(under="ignore"):
            result: Matrix = weights / self._total(targets)
        return result

    def _gaussian(self, distance: Matrix) -> Matrix:
        with np.errstate(under="ignore", over="ignore"):
            # Divide first: squaring a tiny scale would underflow to 0 and give 0 / 0 at the centre.
            values = np.exp(-0.5 * (distance / self.scale) ** 2)
        result: Matrix = np.where(np.abs(distance) <= self.radius, values, 0.0)
        return result

    @property
    def _integral(self) -> float:
        """Sum of the kernel over a sampling much finer than the kernel."""
        return math.sqrt(2.0 * math.pi) * self.scale / self.source.spacing

    def _total(self, targets: Matrix) -> Matrix | float:
        """Return the sum of the kernel about each target over an unbounded sampling like the source."""
        if self.taps is not None:
            return float(self._gaussian(np.arange(-(self.taps // 2), self.taps // 2 + 1, dtype=np.float64)).sum())
        spacing = self.source.spacing
        if self.scale >= MIN_SMOOTH_SCALE * spacing:
            return self._integral
        radius = math.ceil(self.truncate * MIN_SMOOTH_SCALE) + 1
        phase = (targets + 0.5) / spacing - 0.5
        offsets = (phase - np.floor(phase) - np.arange(-radius, radius + 1)) * spacing
        total: Matrix = self._gaussian(offsets).sum(axis=1, keepdims=True)
        return total

    def _series(self, targets: Matrix, sources: Matrix) -> Matrix:
        """Return the reflected Gaussian as a sum of cosines, which has few terms for wide kernels."""
        size = self.source.size
        total = np.ones(np.broadcast_shapes(targets.shape, sources.shape))
        order = 1
        while self.scale < MIN_FLAT_SCALE * size / order:
            weight = 2.0 * math.exp(-0.5 * (math.pi * order * self.scale / size) ** 2)
            wave = math.pi * order / size
            total += weight * np.cos(wave * (targets + 0.5)) * np.cos(wave * (sources + 0.5))
            order += 1
        # The weights sum to 1 over the samples, not over the integral.
        result: Matrix = total / (self._total(targets) * self.source.cells / self._integral)
        return result


def coarsest_spacing(scale: float, eps: float) -> float:
    """Return the coarsest sampling, in pixels, at which a Gaussian of `scale` may be split with an error of `eps`.

    Two Gaussians of variances a and b, one after the other with a sampling of spacing s between them, are the
    Gaussian of variance a + b times a ripple of relative size ``2 exp(-2 pi**2 c / s**2)``, c = a b / (a + b), at any
    distance (complete the square, then Poisson summation). So the tails keep their relative accuracy, and signs
    survive. The first of the two holds VARIANCE_FACTOR times the variance that the ripple needs
    (:func:`pyramid_variance`), which leaves enough for the second, and for another level of at least twice the spacing.
    """
    # a = VARIANCE_FACTOR m s**2 and b = scale**2 - a, with m = _min_variance; c >= m s**2 requires s <= this.
    return scale * math.sqrt((1.0 - 1.0 / VARIANCE_FACTOR) / (VARIANCE_FACTOR * _min_variance(eps)))


def pyramid_variance(spacing: float, eps: float) -> float:
    """Return the variance, in squared pixels, of the blurs up to a pyramid level sampled at `spacing`."""
    return VARIANCE_FACTOR * _min_variance(eps) * spacing**2


def _min_variance(eps: float) -> float:
    """Return the c / s**2 of :func:`coarsest_spacing` at which the ripple is `eps` / 2."""
    return math.log(4.0 / eps) / (2.0 * math.pi**2)


def equivalent_scale(scale: float, taps: int, spacing: float) -> float:
    """Return the scale of the Gaussian that correlates samples `spacing` apart as a truncated one of `scale` does.

    Noise blurred by a kernel k has the correlation (k * k)(s) at a distance s: exp(-s**2 / (4 scale**2)) for a
    Gaussian. For a truncated one it first decreases linearly, as pixels enter and leave all at once.
    """
    radius = taps // 2
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / scale) ** 2)
    products = np.correlate(kernel, kernel, "full")[2 * radius :]
    correlation = float(np.interp(spacing, np.arange(len(products)), products / products[0], right=0.0))
    if correlation == 0.0:
        return 0.0
    return spacing / (2.0 * math.sqrt(-math.log(correlation))) if correlation < 1.0 else scale


def blur_matrix(size: int, scale: float, boundary: Boundary, taps: int | None = None) -> Matrix:
    """Return the matrix that blurs an axis of `size` pixels: float64, shape (size, size), symmetric.

    Parameters
    ----------
    size : int
        Number of pixels of the axis, 1 or more.
    scale, boundary, taps
        See :class:`AxisBlur`.
    """
    pixels = AxisGrid(size, size)
    return AxisBlur(pixels, pixels, scale, boundary, taps).matrix()


MATRICES: Final = Cache[tuple[AxisBlur, object, object, object], Any](2**24)  # at most 64 MiB in float32
"""The matrices of blurs that backends have prepared, by blur and kind of array, for all objectives and devices."""

"""One-dimensional Gaussian blurs between samplings of one axis, as matrices in float64.

A blur of a finite axis is linear, so it is a matrix; its rows can hold any boundary rule, and its transpose is its
exact adjoint. Its outputs need not lie on the pixels, and neither need its inputs: Gaussians after Gaussians are
Gaussians, so a wide blur may pass through coarser samplings and still be exact to rounding (see
:func:`coarsest_spacing`). Two-dimensional Gaussians are the product of two of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from loi_core.method.scales import Boundary

__all__ = [
    "AxisBlur",
    "AxisGrid",
    "Matrix",
    "as_slow_as",
    "blur_matrix",
    "coarsest_spacing",
    "pyramid_variance",
    "reach",
]

Matrix: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

FLAT: Final = 2.7
"""From this many axis lengths on, a reflected Gaussian is flat to 2 exp(-(pi FLAT)**2 / 2) < 1e-15."""

SERIES: Final = 0.5
"""From this many axis lengths on, a reflected Gaussian is summed as a cosine series."""

SMOOTH: Final = 2.0
"""From this many samples on, the sum of a sampled Gaussian is its integral, to 2 exp(-2 (pi SMOOTH)**2) < 1e-33."""

VARIANCE: Final = 4.0 / 3.0
"""Variance of what a level of a pyramid holds, in squared spacings and in units of :func:`_needed`; see there."""


def reach(eps: float) -> float:
    """After how many standard deviations a Gaussian is below `eps` / 2 of its peak."""
    return math.sqrt(2.0 * math.log(2.0 / eps))


@dataclass(frozen=True)
class AxisGrid:
    """A uniform sampling of an axis: the centres of equal cells that cover all of its pixels.

    Attributes
    ----------
    size : int
        Pixels of the axis. They lie at 0, 1, ..., size - 1; the axis reaches from -0.5 to size - 0.5.
    cells : int
        Number of samples; `size` of them are the pixels themselves.
    """

    size: int
    cells: int

    @property
    def spacing(self) -> float:
        """Distance between two samples, in pixels."""
        return self.size / self.cells

    @property
    def positions(self) -> Matrix:
        """Where the samples are, in pixels; shape (cells,)."""
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
        rows sum to 1, and if the samplings are equal so do columns. "zero" pads with zeros.
    taps : int, optional
        Odd length at which the kernel is cut before it is normalised; needs `source` to be the pixels.
    cut : float
        Where the kernel ends if `taps` does not say: after this many standard deviations.
    """

    source: AxisGrid
    target: AxisGrid
    scale: float
    boundary: Boundary
    taps: int | None = None
    cut: float = reach(float(np.finfo(np.float64).eps))

    @property
    def is_identity(self) -> bool:
        """Whether nothing changes."""
        return self.scale == 0.0

    @property
    def transposes(self) -> bool:
        """Whether the matrix is symmetric."""
        return self.source == self.target

    @property
    def radius(self) -> float:
        """How far the kernel reaches, in pixels."""
        if self.taps is not None:
            return float(self.taps // 2)
        if self._is_wide:
            return math.inf
        return self.cut * self.scale

    def matrix(self) -> Matrix:
        """All of it, shape (target.cells, source.cells)."""
        return self.entries(range(self.target.cells), range(self.source.cells))

    def entries(self, rows: range, columns: range) -> Matrix:
        """A contiguous part of the matrix, shape (len(rows), len(columns))."""
        here = self.target.positions[rows.start : rows.stop, None]
        there = self.source.positions[None, columns.start : columns.stop]
        if self.taps is None:
            return self._weights(here, there)
        # A cut kernel may end in a step; its values between two pixels are taken from the two.
        low, high = np.floor(here), np.ceil(here)
        part = here - low
        return (1.0 - part) * self._weights(low, there) + part * self._weights(high, there)

    def support(self, rows: range) -> range:
        """Columns outside which :meth:`entries` of these rows are 0."""
        return self._touched(self.target, rows, self.source)

    def support_of_columns(self, columns: range) -> range:
        """Rows outside which :meth:`entries` of these columns are 0."""
        return self._touched(self.source, columns, self.target)

    @property
    def _is_wide(self) -> bool:
        return self.boundary == "reflect" and self.taps is None and self.scale >= SERIES * self.source.size

    def _touched(self, grid: AxisGrid, indices: range, other: AxisGrid) -> range:
        radius = self.radius + (1.0 if self.taps is not None else 0.0)
        if math.isinf(radius):
            return range(other.cells)
        low = float(grid.positions[indices.start]) - radius
        high = float(grid.positions[indices.stop - 1]) + radius
        if self.boundary == "reflect":
            # What lies beyond an edge is seen in its mirror.
            low, high = min(low, 2 * grid.size - 1 - high), max(high, -1 - low)
        first = math.ceil((low + 0.5) / other.spacing - 0.5 - 1e-9)
        last = math.floor((high + 0.5) / other.spacing - 0.5 + 1e-9)
        return range(min(max(first, 0), other.cells - 1), min(max(last + 1, 1), other.cells))

    def _weights(self, here: Matrix, there: Matrix) -> Matrix:
        if self.is_identity:
            return np.where(here == there, 1.0, 0.0)
        if self._is_wide:
            return self._series(here, there)
        weights = self._gaussian(here - there)
        if self.boundary == "reflect":
            # A mirrored axis repeats with period 2 size; each sample is seen directly and in the mirror.
            period = 2 * self.source.size
            mirrored = here + there + 1.0
            weights = weights + self._gaussian(mirrored)
            for turn in range(1, math.ceil((self.radius + 1.0) / period) + 1):
                for shift in (-turn * period, turn * period):
                    weights = weights + self._gaussian(here - there + shift) + self._gaussian(mirrored + shift)
        with np.errstate(under="ignore"):
            result: Matrix = weights / self._total(here)
        return result

    def _gaussian(self, distance: Matrix) -> Matrix:
        with np.errstate(under="ignore", over="ignore"):
            # Divide first: squaring a tiny scale would underflow to 0 and give 0 / 0 at the centre.
            values = np.exp(-0.5 * (distance / self.scale) ** 2)
        result: Matrix = np.where(np.abs(distance) <= self.radius, values, 0.0)
        return result

    @property
    def _integral(self) -> float:
        """What the kernel sums to over a sampling that is fine beside it."""
        return math.sqrt(2.0 * math.pi) * self.scale / self.source.spacing

    def _total(self, here: Matrix) -> Matrix | float:
        """What the kernel about `here` sums to over an unbounded sampling like the source."""
        if self.taps is not None:
            return float(self._gaussian(np.arange(-(self.taps // 2), self.taps // 2 + 1, dtype=np.float64)).sum())
        spacing = self.source.spacing
        if self.scale >= SMOOTH * spacing:
            return self._integral
        away = math.ceil(self.cut * SMOOTH) + 1
        phase = (here + 0.5) / spacing - 0.5
        offsets = (phase - np.floor(phase) - np.arange(-away, away + 1)) * spacing
        total: Matrix = self._gaussian(offsets).sum(axis=1, keepdims=True)
        return total

    def _series(self, here: Matrix, there: Matrix) -> Matrix:
        """The reflected Gaussian as a sum of cosines, which for wide kernels has few terms and always decays."""
        size = self.source.size
        total = np.ones(np.broadcast_shapes(here.shape, there.shape))
        order = 1
        while self.scale < FLAT * size / order:
            weight = 2.0 * math.exp(-0.5 * (math.pi * order * self.scale / size) ** 2)
            wave = math.pi * order / size
            total += weight * np.cos(wave * (here + 0.5)) * np.cos(wave * (there + 0.5))
            order += 1
        # As everywhere, the weights sum to 1 over the samples, not over the integral.
        result: Matrix = total / (self._total(here) * self.source.cells / self._integral)
        return result


def coarsest_spacing(scale: float, eps: float) -> float:
    """The coarsest sampling, in pixels, on which a Gaussian of `scale` may be interrupted and lose nothing but `eps`.

    Two Gaussians of variances a and b, one after the other with a sampling of spacing s between them, are the
    Gaussian of variance a + b times a ripple of relative size ``2 exp(-2 pi**2 c / s**2)``, c = a b / (a + b), whatever
    the distance (complete the square, then Poisson summation). So the tails keep their relative accuracy, and signs
    survive. The first of the two holds VARIANCE times what the ripple needs (:func:`pyramid_variance`), which leaves
    enough for the second, and for another level of at least twice the spacing.
    """
    need = _needed(eps)
    # a = VARIANCE need s**2 and b = scale**2 - a; c >= need s**2 asks for s <= this.
    return scale * math.sqrt((1.0 - 1.0 / VARIANCE) / (VARIANCE * need))


def pyramid_variance(spacing: float, eps: float) -> float:
    """Variance, in squared pixels, that a cascade has blurred by when it is sampled at `spacing`."""
    return VARIANCE * _needed(eps) * spacing**2


def _needed(eps: float) -> float:
    """The c / s**2 of :func:`coarsest_spacing` at which the ripple is `eps` / 2."""
    return math.log(4.0 / eps) / (2.0 * math.pi**2)


def as_slow_as(scale: float, taps: int, spacing: float) -> float:
    """The scale of the Gaussian that blurs what lies `spacing` apart to be as alike as a cut one of `scale` does.

    Noise that a kernel k has blurred has the correlation (k * k)(s) over a distance s: exp(-s**2 / (4 scale**2)) for a
    Gaussian. Of a cut one it falls off linearly at first, as pixels enter and leave all at once.
    """
    reached = taps // 2
    kernel = np.exp(-0.5 * (np.arange(-reached, reached + 1) / scale) ** 2)
    correlation = np.correlate(kernel, kernel, "full")[2 * reached :]
    alike = float(np.interp(spacing, np.arange(len(correlation)), correlation / correlation[0], right=0.0))
    return spacing / (2.0 * math.sqrt(-math.log(alike))) if 0.0 < alike < 1.0 else 0.0 if alike == 0.0 else scale


def blur_matrix(size: int, scale: float, boundary: Boundary, taps: int | None = None) -> Matrix:
    """The matrix that blurs an axis of `size` pixels with a Gaussian: float64, shape (size, size), symmetric.

    Parameters
    ----------
    size : int
        Number of pixels of the axis, 1 or more.
    scale, boundary, taps
        See :class:`AxisBlur`.
    """
    pixels = AxisGrid(size, size)
    return AxisBlur(pixels, pixels, scale, boundary, taps).matrix()

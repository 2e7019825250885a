"""Coarse samplings of a whole plane, of which only one tile of pixels is there at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from loi_core.method.blurs import PlaneBlur, PlaneGrid
from loi_core.method.gaussian import AxisBlur, AxisGrid, coarsest_spacing, pyramid_variance, reach
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window
from loi_core.support.arrays import Host
from loi_core.support.cache import BESIDE, Cache

__all__ = ["CoarseExtent", "Link", "Pyramid", "is_wide", "tiles_of"]

COARSE: Final = 8.0
"""Spacing, in pixels, from which on all levels of a plane take little memory: 1/64 of it for each level."""

APART: Final = 4.0  # between two samplings of a pyramid, in units of the finer one's spacing
CACHED_ELEMENTS: Final = 2**22


def tiles_of(height: int, width: int, side: int) -> list[Window]:
    """The tiles of a plane, row by row; those at its end are smaller."""
    return [
        Window(range(top, min(top + side, height)), range(left, min(left + side, width)))
        for top in range(0, height, side)
        for left in range(0, width, side)
    ]


def is_wide(scale: float, taps: int | None, longer: int, eps: float) -> bool:
    """Whether a Gaussian passes through a coarse sampling of planes whose longer side is given.

    A Gaussian that is cut off does not: what is left is no Gaussian. One about as wide as the plane does, however small
    the plane, as long as samples are a pixel or more apart. Closer samples need Gaussians narrower than pixels can sum.
    """
    spacing = coarsest_spacing(scale, eps)
    return taps is None and (spacing >= COARSE or (scale >= 0.5 * longer and spacing >= 1.0))


@dataclass(frozen=True)
class Link:
    """A linear map between some pixels and some coarse samples, separable.

    Attributes
    ----------
    window : Window
        The samples that these pixels have to do with.
    rows : array, shape (h, r)
        How much of each row of samples each row of pixels is.
    columns : array, shape (c, w)
        The same of columns.
    spans : array, shape (c, 2)
        Where the rows of `columns` are not 0: from where on, and where no more.
    """

    window: Window
    rows: Host
    columns: Host
    spans: Host

    def gather(self, pixels: Host) -> Host:
        """What pixels, shape (..., h, w), give to the samples in the window."""
        gathered: Host = self.rows.T @ (pixels @ self.columns.T)
        return gathered

    def spread(self, samples: Host) -> Host:
        """What all samples, shape (..., R, C), give to the pixels: the transpose of :meth:`gather`."""
        pixels: Host = (self.rows @ self.window.crop(samples)) @ self.columns
        return pixels

    @property
    def operators(self) -> tuple[Host, Host, Host]:
        """What kernels want of it."""
        return self.rows, self.columns, self.spans


@dataclass(frozen=True)
class CoarseExtent:
    """One wide blur: from which level of a pyramid it starts, and what is left to blur from there to the pixels."""

    scale: float
    start: int
    blur: PlaneBlur


@dataclass(frozen=True)
class Pyramid:
    """The coarse samplings of a plane that some wide Gaussians pass through.

    Beyond an edge at which nothing is mirrored there are zeros. So many of them are taken along that, were the plane
    mirrored after these, no kernel would see it: then all else is the same for both boundaries.

    Attributes
    ----------
    margin : int
        How many such zeros there are at each edge.
    steps : tuple of PlaneBlur
        From the pixels to the first sampling, and from each to the next.
    extents : tuple of CoarseExtent
    """

    margin: int
    steps: tuple[PlaneBlur, ...]
    extents: tuple[CoarseExtent, ...]

    @classmethod
    def of(cls, scales: ScaleSpace, wide: Sequence[float], height: int, width: int, eps: float) -> Pyramid:
        """Coarse samplings for Gaussians of these scales on planes of this size."""
        cut = reach(eps)
        margin = 0 if scales.boundary == "reflect" else math.ceil(0.5 * cut * max(wide)) + 1
        pixels = PlaneGrid.pixels(height + 2 * margin, width + 2 * margin)

        def blur(source: PlaneGrid, target: PlaneGrid, scale: float) -> PlaneBlur:
            return PlaneBlur(
                AxisBlur(source.rows, target.rows, scale, "reflect", None, cut),
                AxisBlur(source.columns, target.columns, scale, "reflect", None, cut),
            )

        steps: list[PlaneBlur] = []
        extents: dict[float, CoarseExtent] = {}
        grid, variance, finest = pixels, 0.0, 0.0
        for scale in sorted(wide):
            spacing = coarsest_spacing(scale, eps)
            if spacing >= APART * finest:
                coarser, reached = _sampled(pixels, spacing), pyramid_variance(spacing, eps)
                steps.append(blur(grid, coarser, math.sqrt(reached - variance)))
                grid, variance, finest = coarser, reached, spacing
            extents[scale] = CoarseExtent(scale, len(steps), blur(grid, pixels, math.sqrt(scale**2 - variance)))
        return cls(margin, tuple(steps), tuple(extents[scale] for scale in wide))

    def shape(self, level: int) -> tuple[int, int]:
        """Rows and columns of a sampling, 1 or more."""
        grid = self.steps[level - 1].target
        return grid.rows.cells, grid.columns.cells

    def down(self, tile: Window, dtype: np.dtype[Any]) -> Link:
        """From the pixels of a tile to the first sampling."""
        blur, seen = self.steps[0], self._within(tile)
        return _link(_seen_by(blur.rows, seen.rows, dtype), _seen_by(blur.columns, seen.columns, dtype))

    def up(self, extent: CoarseExtent, tile: Window, dtype: np.dtype[Any]) -> Link:
        """From the sampling of an extent to the pixels of a tile, the other way round."""
        blur, seen = extent.blur, self._within(tile)
        return _link(_seen_from(blur.rows, seen.rows, dtype), _seen_from(blur.columns, seen.columns, dtype))

    def _within(self, tile: Window) -> Window:
        rows, columns = (range(axis.start + self.margin, axis.stop + self.margin) for axis in (tile.rows, tile.columns))
        return Window(rows, columns)


def _sampled(pixels: PlaneGrid, spacing: float) -> PlaneGrid:
    rows, columns = (
        AxisGrid(axis.size, min(axis.cells, max(1, math.ceil(axis.size / spacing - 1e-9))))
        for axis in (pixels.rows, pixels.columns)
    )
    return PlaneGrid(rows, columns)


_CACHE: Final = Cache[tuple[AxisBlur, int, int, str, np.dtype[Any]], tuple[range, Host]](CACHED_ELEMENTS)


def _seen_by(blur: AxisBlur, pixels: range, dtype: np.dtype[Any]) -> tuple[range, Host]:
    """The samples that a blur makes of some pixels alone, and their weights; shape (pixels, samples)."""
    key = blur, pixels.start, pixels.stop, "by", dtype
    found = _CACHE.get(key)
    if found is None:
        samples = blur.support_of_columns(pixels)
        found = samples, _rounded(blur.entries(samples, pixels).T, dtype)
        _CACHE.put(key, found, found[1].size + BESIDE)
    return found


def _seen_from(blur: AxisBlur, pixels: range, dtype: np.dtype[Any]) -> tuple[range, Host]:
    """The samples of which a blur makes some pixels, and their weights; shape (pixels, samples)."""
    key = blur, pixels.start, pixels.stop, "from", dtype
    found = _CACHE.get(key)
    if found is None:
        samples = blur.support(pixels)
        found = samples, _rounded(blur.entries(pixels, samples), dtype)
        _CACHE.put(key, found, found[1].size + BESIDE)
    return found


def _link(rows: tuple[range, Host], columns: tuple[range, Host]) -> Link:
    across = np.ascontiguousarray(columns[1].T)
    there = across != 0.0
    first, last = np.argmax(there, axis=1), across.shape[1] - np.argmax(there[:, ::-1], axis=1)
    spans = np.stack([first, np.where(there.any(axis=1), last, first)], axis=1)
    return Link(Window(rows[0], columns[0]), rows[1], across, np.ascontiguousarray(spans, np.int64))


def _rounded(matrix: Host, dtype: np.dtype[Any]) -> Host:
    # What no longer has all digits of its dtype adds nothing, and may take a processor a hundred times as long.
    return np.ascontiguousarray(np.where(np.abs(matrix) >= np.finfo(dtype).tiny, matrix, 0.0), dtype)

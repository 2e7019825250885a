"""Rectangles of a plane outside which a stack of planes is 0, so that only what lies inside is stored and computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loi_core.support.arrays import Array, device, namespace, to_numpy

__all__ = ["Window", "window_of"]


@dataclass(frozen=True)
class Window:
    """Some rows and columns of a sampled plane.

    Attributes
    ----------
    rows, columns : range
        Indices of the samples; not empty.
    """

    rows: range
    columns: range

    @classmethod
    def whole(cls, height: int, width: int) -> Window:
        """All of a plane."""
        return cls(range(height), range(width))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and of columns."""
        return len(self.rows), len(self.columns)

    @property
    def cells(self) -> int:
        """Number of samples."""
        return len(self.rows) * len(self.columns)

    @property
    def transposed(self) -> Window:
        """The same of the transposed plane."""
        return Window(self.columns, self.rows)

    def __or__(self, other: Window) -> Window:
        """The smallest window that holds both."""
        return Window(_hull(self.rows, other.rows), _hull(self.columns, other.columns))

    def within(self, other: Window) -> Window:
        """What of it lies in another window; a single sample of that if nothing does, since no window is empty."""
        return Window(_common(self.rows, other.rows), _common(self.columns, other.columns))

    def grown(self, reach: int, height: int, width: int) -> Window:
        """All that is at most `reach` samples away, of a plane of that size."""
        rows, columns = (
            range(max(axis.start - reach, 0), min(axis.stop + reach, size))
            for axis, size in ((self.rows, height), (self.columns, width))
        )
        return Window(rows, columns)

    def seen_from(self, other: Window) -> Window:
        """The same samples, counted from the first of a window that holds them."""
        rows, columns = (
            range(ours.start - theirs.start, ours.stop - theirs.start)
            for ours, theirs in ((self.rows, other.rows), (self.columns, other.columns))
        )
        return Window(rows, columns)

    def crop(self, planes: Array, within: Window | None = None) -> Array:
        """The part of `planes` inside, a view where the library has views.

        Parameters
        ----------
        planes : array, shape (..., H, W)
            All of the plane, or what lies in `within`.
        within : Window, optional
            A window that holds this one.
        """
        top, left = (within.rows.start, within.columns.start) if within else (0, 0)
        rows = slice(self.rows.start - top, self.rows.stop - top)
        return planes[..., rows, self.columns.start - left : self.columns.stop - left]

    def paste(self, part: Array, height: int, width: int, within: Window | None = None) -> Array:
        """Planes of `height` by `width` samples, those of `within` if given, that are `part` inside and 0 elsewhere."""
        if self.shape == (height, width):
            return part
        xp = namespace(part)
        planes = xp.zeros((*part.shape[:-2], height, width), dtype=part.dtype, device=device(part))
        inside = self.crop(planes, within)
        inside += part
        return planes


def window_of(mask: Array) -> Window | None:
    """The smallest window outside which `mask`, booleans of shape (N, H, W), is False; None if it is False everywhere.

    Looks at values, so it is for arrays that are computed as they are written down, on the host.
    """
    xp = namespace(mask)
    plane = xp.any(mask, axis=0)
    (rows,), (columns,) = (np.nonzero(to_numpy(xp.any(plane, axis=axis))) for axis in (1, 0))
    if not len(rows):
        return None
    return Window(range(int(rows[0]), int(rows[-1]) + 1), range(int(columns[0]), int(columns[-1]) + 1))


def _common(one: range, other: range) -> range:
    common = range(max(one.start, other.start), min(one.stop, other.stop))
    return common if len(common) else other[:1]


def _hull(one: range, other: range) -> range:
    return range(min(one.start, other.start), max(one.stop, other.stop))

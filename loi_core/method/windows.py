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


def _hull(one: range, other: range) -> range:
    return range(min(one.start, other.start), max(one.stop, other.stop))

"""Windows of a plane, outside which a stack of planes is 0, so that only the part inside is stored and computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loi_core.support.arrays import Array, device, namespace, to_numpy

__all__ = ["Window", "window_of"]


@dataclass(frozen=True)
class Window:
    """A rectangle of samples of a plane.

    Attributes
    ----------
    rows, columns : range
        Indices of the samples; not empty.
    """

    rows: range
    columns: range

    @classmethod
    def whole(cls, height: int, width: int) -> Window:
        """Return the window of a whole plane."""
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
        """The same window of the transposed plane."""
        return Window(self.columns, self.rows)

    def __or__(self, window: Window) -> Window:
        """Return the smallest window that contains both."""
        return Window(_hull(self.rows, window.rows), _hull(self.columns, window.columns))

    def crop(self, planes: Array, frame: Window | None = None) -> Array:
        """Return the part of `planes` inside the window, a view where the library has views.

        Parameters
        ----------
        planes : array, shape (..., H, W)
            Whole planes, or their part inside `frame`.
        frame : Window, optional
            A window that contains this one.
        """
        top, left = (frame.rows.start, frame.columns.start) if frame else (0, 0)
        rows = slice(self.rows.start - top, self.rows.stop - top)
        return planes[..., rows, self.columns.start - left : self.columns.stop - left]

    def paste(self, inside: Array, height: int, width: int, frame: Window | None = None) -> Array:
        """Return planes of `height` by `width` samples, 0 outside the window; `frame` places them like :meth:`crop`."""
        if self.shape == (height, width):
            return inside
        xp = namespace(inside)
        planes = xp.zeros((*inside.shape[:-2], height, width), dtype=inside.dtype, device=device(inside))
        target = self.crop(planes, frame)
        target += inside
        return planes


def window_of(mask: Array) -> Window | None:
    """Return the smallest window outside which `mask`, booleans of shape (N, H, W), is False; None if there is none.

    Reads values, so the array must be computed eagerly on the host.
    """
    xp = namespace(mask)
    plane = xp.any(mask, axis=0)
    (rows,), (columns,) = (np.nonzero(to_numpy(xp.any(plane, axis=axis))) for axis in (1, 0))
    if not len(rows):
        return None
    return Window(range(int(rows[0]), int(rows[-1]) + 1), range(int(columns[0]), int(columns[-1]) + 1))


def _hull(first: range, second: range) -> range:
    return range(min(first.start, second.start), max(first.stop, second.stop))

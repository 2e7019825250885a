"""Windows of images that may be large, or in files: as planes of floats, masked, toned and clipped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loi_core.errors import ImageError, NonFiniteImageError
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window
from loi_core.pixels.bounds import above_padding, clip, clip_pullback
from loi_core.pixels.layout import Layout
from loi_core.pixels.tone_curve import LogTone
from loi_core.pixels.weights import given_weights, largest_weight, require_some
from loi_core.support.arrays import Array, Host, as_floating, is_numpy_array, to_numpy

__all__ = ["Pixels", "Plane", "Shares"]


@dataclass(frozen=True)
class Pixels:
    """An image of which only windows are looked at.

    Attributes
    ----------
    name : str
        Of the argument, for messages.
    given : array, shape (H, W, C), or as `layout` says
        On the host, maybe a memory map.
    layout : Layout
    dtype : dtype
        In which it is compared: float32 or float64.
    """

    name: str
    given: Host
    layout: Layout
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, name: str, image: Array, channel_axis: int | None) -> Pixels:
        """An image of one shape; what is not on the host is copied there.

        Raises
        ------
        ImageTypeError
            If it is no array of floating-point values or unsigned integers.
        ImageError
            If it has a batch, too few axes, or no pixels.
        """
        unsigned = is_numpy_array(image) and image.dtype.kind == "u" and image.dtype.isnative
        if not unsigned:
            as_floating(name, image)
        given = image if is_numpy_array(image) else to_numpy(image)
        axes = 2 if channel_axis is None else 3
        if given.ndim > axes:
            msg = f"`{name}` must have {axes} axes, as large images come one at a time, got shape {given.shape}"
            raise ImageError(msg)
        layout = Layout.of(name, given.shape, channel_axis)
        dtype = np.dtype(np.float64 if given.dtype.itemsize > 4 and not unsigned else np.float32)
        return cls(name, given, layout, dtype)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, in pixels."""
        return self.layout.height, self.layout.width

    @property
    def planes(self) -> int:
        """How many channels there are."""
        return 1 if self.layout.channel_axis is None else self.layout.shape[self.layout.channel_axis]

    def values(self, window: Window) -> Host:
        """The values in a window, as the image lies."""
        return self._floats(self.given[self._index(window, slice(None))], self.dtype)

    def plane(self, window: Window, channel: int, dtype: np.dtype[Any]) -> Host:
        """One channel of a window, shape (h, w)."""
        return self._floats(self.given[self._index(window, channel)], dtype)

    def view(self, array: Host, channel: int) -> Host:
        """One channel of an array that lies as the image does, shape (H, W); writing there writes to it."""
        return array[self._index(Window.whole(*self.size), channel)]

    def every(self, step: int) -> Host:
        """Every so many rows and columns."""
        rows, columns = self._axes
        index: list[slice] = [slice(None)] * self.given.ndim
        index[rows] = index[columns] = slice(None, None, step)
        return self._floats(self.given[tuple(index)], self.dtype)

    def spread(self, mask: Host) -> Host:
        """A mask of a window's pixels, shape (h, w), as an array that broadcasts with :meth:`values`."""
        return mask if self.layout.channel_axis is None else np.expand_dims(mask, self.layout.channel_axis)

    def moved(self, error: NonFiniteImageError, window: Window) -> tuple[int, ...]:
        """Where the first value is that an error has found in a window."""
        rows, columns = self._axes
        first = list(error.first)
        first[rows] += window.rows.start
        first[columns] += window.columns.start
        return tuple(first)

    @property
    def _axes(self) -> tuple[int, int]:
        rows, columns = (axis for axis in range(self.given.ndim) if axis != self.layout.channel_axis)
        return rows, columns

    def _index(self, window: Window, channel: int | slice) -> tuple[int | slice, ...]:
        rows, columns = self._axes
        index: list[int | slice] = [channel] * self.given.ndim
        index[rows] = slice(window.rows.start, window.rows.stop)
        index[columns] = slice(window.columns.start, window.columns.stop)
        return tuple(index)

    def _floats(self, values: Host, dtype: np.dtype[Any]) -> Host:
        floats = np.asarray(values).astype(dtype)
        if self.given.dtype.kind == "u":
            floats /= np.iinfo(self.given.dtype).max
        return floats


@dataclass(frozen=True)
class Shares:
    """How much each pixel counts, of which only windows are looked at.

    Attributes
    ----------
    given : array, shape (H, W)
    largest : float
    """

    given: Host
    largest: float

    @classmethod
    def of(cls, weights: object, size: tuple[int, int], tiles: Sequence[Window]) -> Shares:
        """Weights of images of one size.

        Raises
        ------
        ImageTypeError
            If they are no array of numbers.
        ImageError
            If the shape does not fit, a weight is negative or not finite, or all are 0.
        """
        given = given_weights(weights)
        if given.shape != size:
            msg = f"`weights` must have shape {size}, one for each pixel of the reference, got {given.shape}"
            raise ImageError(msg)
        parts = (np.asarray(tile.crop(given), np.float64) for tile in tiles)
        return cls(given, require_some(max(map(largest_weight, parts))))

    def within(self, window: Window, dtype: np.dtype[Any]) -> Host:
        """In units of the largest, shape (h, w)."""
        return (np.asarray(window.crop(self.given), np.float64) / self.largest).astype(dtype)


@dataclass
class Plane:
    """One channel of an image and of a reference, window by window: a `loi_core.method.tiled.inner.TiledPlane`.

    Attributes
    ----------
    pixels, wanted : Pixels
        The image, and the reference.
    channel : int
    scales : ScaleSpace
        Of the bounds.
    masks : bool
        Whether pixels that are not finite are taken as equal to the reference.
    tone : LogTone, optional
    weights : Shares, optional
    cotangent : array, shape (H, W), optional
        Where the cotangent goes.
    factor : float
        The most that a cotangent is multiplied by on its way to the image, once it has been carried there.
    """

    pixels: Pixels
    wanted: Pixels
    channel: int
    scales: ScaleSpace
    masks: bool
    tone: LogTone | None
    weights: Shares | None
    cotangent: Host | None
    factor: float = field(init=False, default=1.0)

    def image(self, window: Window) -> Host:
        """Intensities above the padding, within the bounds; shape (h, w)."""
        return self._compared(self._toned(window)[1])

    def reference(self, window: Window) -> Host:
        """The same of the reference."""
        return self._compared(self._reference(window))

    def shares(self, window: Window) -> Host:
        """How much each pixel counts, shape (h, w), or (0, 0) if all count alike."""
        if self.weights is None:
            return np.zeros((0, 0), self.pixels.dtype)
        return self.weights.within(window, self.pixels.dtype)

    def add(self, window: Window, cotangent: Host) -> None:
        """Add to the cotangent."""
        if self.cotangent is not None:
            inside = window.crop(self.cotangent)
            inside += cotangent

    def clear(self, tiles: Sequence[Window]) -> None:
        """Make the cotangent 0."""
        if self.cotangent is not None:
            for tile in tiles:
                tile.crop(self.cotangent)[...] = 0.0

    def carry_back(self, tiles: Sequence[Window]) -> float:
        """Carry the cotangent, which is that by intensities, to the image's values; its 2-norm."""
        if self.cotangent is None:
            return 0.0
        squares = 0.0
        for tile in tiles:
            raw, toned, seen = self._toned(tile)
            inside = tile.crop(self.cotangent)
            part = clip_pullback(toned, np.asarray(inside), *self.scales.bounds)
            if self.tone is not None:
                self.factor = max(self.factor, float(np.max(self.tone.pullback(raw, np.ones_like(raw)))))
                part = self.tone.pullback(raw, part)
            if seen is not None:
                part = np.where(seen, part, 0.0)
            squares += float(np.sum(np.square(part, dtype=np.float64)))
            inside[...] = part if self.weights is None else part * self.weights.largest
        return math.sqrt(squares)

    def _toned(self, window: Window) -> tuple[Host, Host, Host | None]:
        """The image's values, 0 where they are hidden; what they are compared as; and where they are not hidden."""
        raw = self.pixels.plane(window, self.channel, self.pixels.dtype)
        seen = None
        if self.masks:
            wanted = self.wanted.plane(window, self.channel, self.pixels.dtype)
            seen = np.isfinite(raw) & np.isfinite(wanted)
        if self.weights is not None:
            counts = self.weights.within(window, self.pixels.dtype) > 0.0
            seen = counts if seen is None else seen & counts
        if seen is None:
            return raw, raw if self.tone is None else self.tone.apply(raw), None
        raw = np.where(seen, raw, 0.0)
        toned = raw if self.tone is None else self.tone.apply(raw)
        return raw, np.where(seen, toned, self._reference(window)), seen

    def _reference(self, window: Window) -> Host:
        wanted = self.wanted.plane(window, self.channel, self.pixels.dtype)
        if self.masks or self.weights is not None:
            # A pixel that is hidden keeps what the reference has there, if that is a number.
            wanted = np.where(np.isfinite(wanted), wanted, 0.0)
        return wanted if self.tone is None else self.tone.apply(wanted)

    def _compared(self, toned: Host) -> Host:
        low, high = self.scales.bounds
        compared: Host = above_padding(clip(toned, low, high), self.scales.padding)
        return compared

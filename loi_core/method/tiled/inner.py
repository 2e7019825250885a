"""One plane and its reference at one inner scale, and the way back from there, by windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from loi_core.method.tiled.coarse import Pyramid
from loi_core.method.tiled.narrow import NarrowBlur
from loi_core.method.windows import Window
from loi_core.support.arrays import Host

__all__ = ["Inner", "NarrowlyBlurred", "TiledPlane", "Unblurred", "WidelyBlurred"]


class TiledPlane(Protocol):
    """One plane of an image and of its reference, of which some windows are looked at; and where its cotangent goes."""

    def image(self, window: Window) -> Host:
        """Intensities above the padding, within the bounds; shape (h, w)."""

    def reference(self, window: Window) -> Host:
        """The same of the reference."""

    def shares(self, window: Window) -> Host:
        """How much each pixel counts, shape (h, w), or (0, 0) if all count alike."""

    def add(self, window: Window, cotangent: Host) -> None:
        """Add to the cotangent of the plane."""


class Inner(Protocol):
    """Blurred intensities, and where cotangents by them go. Only :meth:`add` and :meth:`finish` change anything."""

    def image(self, window: Window) -> Host:
        """Blurred intensities above the padding, shape (h, w)."""

    def reference(self, window: Window) -> Host:
        """The same of the reference."""

    def pulled_back(self, window: Window, cotangent: Host) -> tuple[Window, Host]:
        """What a cotangent by a window's blurred intensities is before the blur, for :meth:`add`."""

    def add(self, window: Window, part: Host) -> None:
        """Take note of what :meth:`pulled_back` has given."""

    def finish(self) -> None:
        """Add what is left to the plane's cotangent."""


@dataclass(frozen=True)
class Unblurred:
    """The inner scale 0."""

    plane: TiledPlane

    def image(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.plane.image(window)

    def reference(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.plane.reference(window)

    def pulled_back(self, window: Window, cotangent: Host) -> tuple[Window, Host]:
        """See :class:`Inner`."""
        return window, cotangent

    def add(self, window: Window, part: Host) -> None:
        """See :class:`Inner`."""
        self.plane.add(window, part)

    def finish(self) -> None:
        """See :class:`Inner`; there is nothing left."""


@dataclass(frozen=True)
class NarrowlyBlurred:
    """An inner scale that sees no further than a halo."""

    plane: TiledPlane
    blur: NarrowBlur

    def image(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.blur.apply(self.plane.image(self.blur.seen(window)), window)

    def reference(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.blur.apply(self.plane.reference(self.blur.seen(window)), window)

    def pulled_back(self, window: Window, cotangent: Host) -> tuple[Window, Host]:
        """See :class:`Inner`."""
        return self.blur.seen(window), self.blur.adjoint(cotangent, window)

    def add(self, window: Window, part: Host) -> None:
        """See :class:`Inner`."""
        self.plane.add(window, part)

    def finish(self) -> None:
        """See :class:`Inner`; there is nothing left."""


@dataclass
class WidelyBlurred:
    """An inner scale that passes through a coarse sampling of the whole plane."""

    plane: TiledPlane
    pyramid: Pyramid
    tiles: Sequence[Window]
    dtype: np.dtype[Any]
    _image: Host = field(init=False)
    _reference: Host = field(init=False)
    _pulled: Host = field(init=False)

    def __post_init__(self) -> None:
        self._image, self._reference, self._pulled = (np.zeros(self.pyramid.shape(1), self.dtype) for _ in range(3))
        for tile in self.tiles:
            link = self.pyramid.down(tile, self.dtype)
            for samples, part in (
                (self._image, self.plane.image(tile)),
                (self._reference, self.plane.reference(tile)),
            ):
                inside = link.window.crop(samples)
                inside += link.gather(part)

    def image(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.pyramid.up(self.pyramid.extents[0], window, self.dtype).spread(self._image)

    def reference(self, window: Window) -> Host:
        """See :class:`Inner`."""
        return self.pyramid.up(self.pyramid.extents[0], window, self.dtype).spread(self._reference)

    def pulled_back(self, window: Window, cotangent: Host) -> tuple[Window, Host]:
        """See :class:`Inner`."""
        link = self.pyramid.up(self.pyramid.extents[0], window, self.dtype)
        return link.window, link.gather(cotangent)

    def add(self, window: Window, part: Host) -> None:
        """See :class:`Inner`."""
        inside = window.crop(self._pulled)
        inside += part

    def finish(self) -> None:
        """See :class:`Inner`."""
        for tile in self.tiles:
            self.plane.add(tile, self.pyramid.down(tile, self.dtype).spread(self._pulled))

"""Objects that move along one axis: intervals on a line of pixels, and disks in one row of a picture."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from loi_core.renderers import Disks

__all__ = ["DiskRow", "Host", "Line", "Movers"]

Host: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Movers(abc.ABC):
    """Objects painted over one another, each whole in the frame; every pixel is covered by exact area.

    Attributes
    ----------
    width : int
        Number of pixels along the axis; pixel i reaches from i to i + 1.
    radii : tuple of float
        Half the lengths of the objects, in pixels.
    intensities : tuple of float
        Of the objects; a later one hides an earlier one.
    anchors : tuple of float
        Centres of the objects, in pixels, when the parameter that they follow is 0.
    follows : tuple of int or None
        Number of the parameter that moves each object; None for those that stay.
    background : float
    """

    width: int
    radii: tuple[float, ...]
    intensities: tuple[float, ...]
    anchors: tuple[float, ...] = (0.0,)
    follows: tuple[int | None, ...] = (0,)
    background: float = 0.0

    @property
    def bounds(self) -> tuple[Host, Host]:
        """Least and greatest parameters at which all that moves is whole, each (P,), in pixels."""
        lows, highs = [], []
        for number in range(len(self._ways)):
            reach = zip(self.radii, self.anchors, self.follows, strict=True)
            own = [(radius - at, self.width - radius - at) for radius, at, parameter in reach if parameter == number]
            lows.append(max(low for low, _ in own))
            highs.append(min(high for _, high in own))
        return np.array(lows), np.array(highs)

    @abc.abstractmethod
    def images(self, places: Host) -> Host:
        """Images, shape (N, H, width), for parameters of shape (N, P), in pixels."""

    @abc.abstractmethod
    def slopes(self, places: Host, gradients: Host) -> Host:
        """Derivatives by the parameters, shape (N, P), of what has these `gradients` by the images, (N, H, width).

        Where an edge meets the border of a pixel the derivative jumps; there it is that of the way to the right.
        """

    @property
    def _ways(self) -> Host:
        """How each object moves with each parameter, 0 or 1, shape (P, objects)."""
        count = 1 + max(one for one in self.follows if one is not None)
        return np.array([[float(one == number) for one in self.follows] for number in range(count)])

    def _centres(self, places: Host) -> Host:
        """Of all objects, shape (N, objects)."""
        return np.asarray(self.anchors + places @ self._ways)


class Line(Movers):
    """Intervals on one row of pixels: disks of the paper's figures, cut along their middle."""

    def images(self, places: Host) -> Host:
        """Of one row each, H = 1."""
        return self.changes(places)[0][:, None, :]

    def slopes(self, places: Host, gradients: Host) -> Host:
        """See :class:`Movers`."""
        return np.asarray(np.einsum("nhw,nwp->np", gradients, self.changes(places)[1]))

    def changes(self, places: Host) -> tuple[Host, Host]:
        """Signals, shape (N, width), and their derivatives by the parameters, shape (N, width, P), one over pixels."""
        signals = np.full((len(places), self.width), self.background)
        changes = np.zeros((*signals.shape, len(self.radii)))
        centres = self._centres(places)
        for index, (radius, intensity) in enumerate(zip(self.radii, self.intensities, strict=True)):
            cover, change = _coverage(self.width, centres[:, index], radius)
            changes *= (1.0 - cover)[:, :, None]
            changes[:, :, index] = change * (intensity - signals)
            signals = signals + cover * (intensity - signals)
        return signals, changes @ self._ways.T


class DiskRow(Movers):
    """Disks whose centres are in the middle row of a square picture."""

    def images(self, places: Host) -> Host:
        """Square, H = width."""
        return np.stack([self._render(one)[0][..., 0] for one in self._centres(places)])

    def slopes(self, places: Host, gradients: Host) -> Host:
        """See :class:`Movers`."""
        unused = np.zeros((*gradients.shape[1:], 2))
        found = []
        for one, gradient in zip(self._centres(places), gradients, strict=True):
            by_position = self._render(one)[1](np.concatenate([gradient[..., None], unused], axis=-1))["positions"]
            found.append(self._ways @ by_position[:, 0])
        return np.stack(found)

    def _render(self, centres: Host) -> tuple[Host, Any]:
        middle = np.full(len(centres), 0.5 * self.width)
        colours = np.repeat(np.array(self.intensities)[:, None], 3, axis=1)
        positions = np.stack([centres, middle], axis=-1)
        disks = Disks(self.width, self.width, positions, np.array(self.radii), colours, [self.background] * 3)
        return disks.render_vjp(disks.parameters())


def _coverage(width: int, centres: Host, radius: float) -> tuple[Host, Host]:
    """How much of every pixel an interval covers, shape (N, width), and the derivative of that by its centre."""
    left = np.arange(width, dtype=np.float64)
    start, end = (centres - radius)[:, None], (centres + radius)[:, None]
    cover = np.clip(np.minimum(left + 1.0, end) - np.maximum(left, start), 0.0, 1.0)
    inside_start, inside_end = (np.floor(edge) == left for edge in (start, end))
    return cover, inside_end.astype(np.float64) - inside_start.astype(np.float64)

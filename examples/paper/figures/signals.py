"""Objects that move along one axis: intervals on a line of pixels, and disks in one row of a picture."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from loi_core.renderers import Disks

__all__ = ["DiskRow", "Host", "Line", "MovingObjects"]

Host: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class MovingObjects(abc.ABC):
    """Objects painted over one another, each entirely inside the frame, with exact pixel coverage.

    Attributes
    ----------
    width : int
        Number of pixels along the axis; pixel i extends from i to i + 1.
    radii : tuple of float
        Half the lengths of the objects, in pixels.
    intensities : tuple of float
        Intensities of the objects, in the order of painting.
    anchors : tuple of float
        Centres of the objects where their parameter is 0, in pixels.
    parameter_indices : tuple of int or None
        Index of the parameter that moves each object; None for a fixed object.
    background : float
    """

    width: int
    radii: tuple[float, ...]
    intensities: tuple[float, ...]
    anchors: tuple[float, ...] = (0.0,)
    parameter_indices: tuple[int | None, ...] = (0,)
    background: float = 0.0

    @property
    def bounds(self) -> tuple[Host, Host]:
        """Lower and upper bounds of the parameters, each (P,), in pixels, between which moving objects are entire."""
        lower, upper = [], []
        for parameter in range(len(self._jacobian)):
            objects = zip(self.radii, self.anchors, self.parameter_indices, strict=True)
            moved = [(radius, anchor) for radius, anchor, index in objects if index == parameter]
            lower.append(max(radius - anchor for radius, anchor in moved))
            upper.append(min(self.width - radius - anchor for radius, anchor in moved))
        return np.array(lower), np.array(upper)

    @abc.abstractmethod
    def images(self, params: Host) -> Host:
        """Return images, shape (N, H, width), for parameters of shape (N, P), in pixels."""

    @abc.abstractmethod
    def vjp(self, params: Host, cotangents: Host) -> Host:
        """Return derivatives with respect to the parameters, shape (N, P), for image gradients of shape (N, H, width).

        Where an edge meets a pixel border the derivative jumps; the result is the derivative to the right.
        """

    @property
    def _jacobian(self) -> Host:
        """Derivative of every centre with respect to every parameter, 0 or 1, shape (P, objects)."""
        count = 1 + max(index for index in self.parameter_indices if index is not None)
        return np.array([[float(index == parameter) for index in self.parameter_indices] for parameter in range(count)])

    def _centres(self, params: Host) -> Host:
        """Return the centres of all objects, shape (N, objects)."""
        return np.asarray(self.anchors + params @ self._jacobian)


class Line(MovingObjects):
    """Intervals on one row of pixels: the disks of the paper's figures, cut along their middle."""

    def images(self, params: Host) -> Host:
        """Return images of one row, H = 1."""
        return self.signals(params)[0][:, None, :]

    def vjp(self, params: Host, cotangents: Host) -> Host:
        """See :class:`MovingObjects`."""
        return np.asarray(np.einsum("nhw,nwp->np", cotangents, self.signals(params)[1]))

    def signals(self, params: Host) -> tuple[Host, Host]:
        """Return signals, shape (N, width), and their derivatives with respect to the parameters, (N, width, P)."""
        signals = np.full((len(params), self.width), self.background)
        derivatives = np.zeros((*signals.shape, len(self.radii)))
        centres = self._centres(params)
        for index, (radius, intensity) in enumerate(zip(self.radii, self.intensities, strict=True)):
            coverage, coverage_derivative = _coverage(self.width, centres[:, index], radius)
            derivatives *= (1.0 - coverage)[:, :, None]
            derivatives[:, :, index] = coverage_derivative * (intensity - signals)
            signals = signals + coverage * (intensity - signals)
        return signals, derivatives @ self._jacobian.T


class DiskRow(MovingObjects):
    """Disks whose centres are in the middle row of a square picture."""

    def images(self, params: Host) -> Host:
        """Return square images, H = width."""
        return np.stack([self._render(centres)[0][..., 0] for centres in self._centres(params)])

    def vjp(self, params: Host, cotangents: Host) -> Host:
        """See :class:`MovingObjects`."""
        unused_channels = np.zeros((*cotangents.shape[1:], 2))
        derivatives = []
        for centres, cotangent in zip(self._centres(params), cotangents, strict=True):
            pullback = self._render(centres)[1]
            by_position = pullback(np.concatenate([cotangent[..., None], unused_channels], axis=-1))["positions"]
            derivatives.append(self._jacobian @ by_position[:, 0])
        return np.stack(derivatives)

    def _render(self, centres: Host) -> tuple[Host, Any]:
        middle = np.full(len(centres), 0.5 * self.width)
        colours = np.repeat(np.array(self.intensities)[:, None], 3, axis=1)
        positions = np.stack([centres, middle], axis=-1)
        disks = Disks(self.width, self.width, positions, np.array(self.radii), colours, [self.background] * 3)
        return disks.render_vjp(disks.parameters())


def _coverage(width: int, centres: Host, radius: float) -> tuple[Host, Host]:
    """Return the share of every pixel that an interval covers, shape (N, width), and its derivative by the centre."""
    left = np.arange(width, dtype=np.float64)
    first_edge, last_edge = (centres - radius)[:, None], (centres + radius)[:, None]
    coverage = np.clip(np.minimum(left + 1.0, last_edge) - np.maximum(left, first_edge), 0.0, 1.0)
    has_first_edge, has_last_edge = (np.floor(edge) == left for edge in (first_edge, last_edge))
    return coverage, has_last_edge.astype(np.float64) - has_first_edge.astype(np.float64)

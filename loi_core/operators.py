"""Blurs of stacks of planes, behind the one interface through which the losses use them.

How a blur is computed may change with the scale, the size and the accuracy asked for; the losses only ever apply
it, apply its adjoint, and ask how the samples of its output are to be averaged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from loi_core.arrays import Array, from_numpy, namespace
from loi_core.kernels import blur_matrix
from loi_core.scales import Boundary

__all__ = ["Blur", "DenseBlur", "IdentityBlur", "blur_about", "gaussian_blur"]


class Blur(Protocol):
    """A linear map of planes, shape (..., H, W), to planes, shape (..., h, w)."""

    def apply(self, planes: Array) -> Array:
        """The blurred planes, shape (..., h, w)."""

    def adjoint(self, planes: Array) -> Array:
        """The transpose of :meth:`apply`: planes of shape (..., h, w) to shape (..., H, W)."""


@dataclass(frozen=True)
class IdentityBlur:
    """The blur of scale 0: nothing changes."""

    def apply(self, planes: Array) -> Array:
        """`planes` itself."""
        return planes

    def adjoint(self, planes: Array) -> Array:
        """`planes` itself."""
        return planes


@dataclass(frozen=True)
class DenseBlur:
    """A separable blur as one dense matrix per axis.

    Attributes
    ----------
    rows : array, shape (h, H)
        Acts on the vertical axis.
    columns : array, shape (w, W)
        Acts on the horizontal axis.
    """

    rows: Array
    columns: Array

    def apply(self, planes: Array) -> Array:
        """``rows @ planes @ columns.T`` for every plane."""
        return _sandwich(self.rows, planes, self.columns)

    def adjoint(self, planes: Array) -> Array:
        """``rows.T @ planes @ columns`` for every plane."""
        return _sandwich(self.rows.T, planes, self.columns.T)


def _sandwich(left: Array, planes: Array, right: Array) -> Array:
    xp = namespace(planes)
    *stack, height, width = planes.shape
    # One tall product along the last axis is several times faster than a product per plane.
    across = xp.matmul(xp.reshape(planes, (-1, width)), right.T)
    return xp.matmul(left, xp.reshape(across, (*stack, height, right.shape[0])))


def blur_about(blur: Blur, planes: Array, padding: float) -> Array:
    """`planes` blurred as if `padding`, not 0, lay outside them. Its adjoint is that of the blur."""
    return blur.apply(planes) if padding == 0.0 else blur.apply(planes - padding) + padding


def gaussian_blur(
    height: int, width: int, scale: float, boundary: Boundary, *, like: Array, taps: int | None = None
) -> Blur:
    """The Gaussian blur of planes of `height` by `width` pixels.

    Parameters
    ----------
    height, width : int
        Size of the planes.
    scale : float
        Standard deviation in pixels; 0 gives the identity.
    boundary : {"reflect", "zero"}
        See :func:`loi_core.kernels.blur_matrix`.
    like : array
        Its library, dtype and device are those of the operator.
    taps : int, optional
        Odd length at which the kernel is cut; as long as matters in float64 by default.
    """
    if scale == 0.0:
        return IdentityBlur()
    rows = from_numpy(blur_matrix(height, scale, boundary, taps), like)
    columns = rows if width == height else from_numpy(blur_matrix(width, scale, boundary, taps), like)
    return DenseBlur(rows, columns)

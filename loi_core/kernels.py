"""One-dimensional Gaussian blurs on a finite axis, as matrices in float64.

A blur of a finite axis is linear, so it is a matrix; its rows can hold any boundary rule, and its transpose is
its exact adjoint. Two-dimensional Gaussians are the product of two of these.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np

from loi_core.scales import Boundary

__all__ = ["blur_matrix", "gaussian_taps"]

Matrix: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

NEGLIGIBLE = 8.6  # exp(-8.6**2 / 2) < 2**-53: a tap this many sigmas out vanishes beside the central one


def gaussian_taps(scale: float, radius: int) -> Matrix:
    """Samples of a Gaussian at the integers -radius ... radius, normalised to sum 1.

    Parameters
    ----------
    scale : float
        Standard deviation in samples, 0 or more; 0 gives a single 1.
    radius : int
        How many samples lie on either side of the centre.
    """
    offsets = np.arange(-radius, radius + 1, dtype=np.float64)
    if scale == 0.0:
        return np.where(offsets == 0.0, 1.0, 0.0)
    with np.errstate(under="ignore", over="ignore"):
        # Divide first: squaring a tiny scale would underflow to 0 and give 0 / 0 at the centre.
        taps: Matrix = np.exp(-0.5 * (offsets / scale) ** 2)
    normalised: Matrix = taps / taps.sum()
    return normalised


def blur_matrix(size: int, scale: float, boundary: Boundary, taps: int | None = None) -> Matrix:
    """The matrix that blurs an axis of `size` samples with a Gaussian.

    Parameters
    ----------
    size : int
        Number of samples of the axis, 1 or more.
    scale : float
        Standard deviation in samples; 0 gives the identity.
    boundary : {"reflect", "zero"}
        "reflect" mirrors about the edge of the first and last sample (half-sample symmetric), any number of
        times: rows and columns sum to 1. "zero" pads with zeros.
    taps : int, optional
        Odd length at which the kernel is cut before it is normalised; as long as matters in float64 by default.

    Returns
    -------
    array, shape (size, size), float64
        Symmetric, so its own adjoint.
    """
    cut = math.ceil(NEGLIGIBLE * scale) if taps is None else taps // 2
    if boundary == "zero":
        return _zero_padded(size, scale, cut)
    return _reflected(size, scale, cut, exact=taps is None)


def _distances(size: int) -> tuple[np.ndarray[Any, np.dtype[np.intp]], np.ndarray[Any, np.dtype[np.intp]]]:
    index = np.arange(size)
    return np.abs(index[:, None] - index[None, :]), index[:, None] + index[None, :] + 1


def _zero_padded(size: int, scale: float, cut: int) -> Matrix:
    # The kernel may be far longer than the axis: only offsets within the axis are stored, and the sum that
    # normalises it is, beyond 2 samples of width, sqrt(2 pi) scale to better than 1e-30 (Poisson summation).
    reach = min(cut, size - 1)
    if cut == reach or scale <= 2.0 or cut < NEGLIGIBLE * scale - 1:
        kernel = gaussian_taps(scale, cut)[cut : cut + reach + 1]
    else:
        kernel = np.exp(-0.5 * (np.arange(reach + 1) / scale) ** 2) / (math.sqrt(2.0 * math.pi) * scale)
    row = np.zeros(size)
    row[: reach + 1] = kernel
    matrix: Matrix = row[_distances(size)[0]]
    return matrix


def _reflected(size: int, scale: float, cut: int, *, exact: bool) -> Matrix:
    # A mirrored axis repeats with period 2 size. Folding the kernel into one period handles kernels of any
    # length; each sample is then seen directly and in the mirror.
    period = 2 * size
    if exact and scale >= 2.0 * period:
        # Poisson summation: the folded kernel differs from flat by 2 exp(-2 (pi scale / period)**2) < 1e-34.
        folded = np.full(period, 1.0 / period)
    else:
        kernel = gaussian_taps(scale, cut)
        folded = np.bincount(np.arange(-cut, cut + 1) % period, weights=kernel, minlength=period)
    direct, mirrored = _distances(size)
    matrix: Matrix = folded[direct] + folded[mirrored % period]
    return matrix

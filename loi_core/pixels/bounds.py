"""Clipping of intensities to the bounds of a scale space, with a pullback that points back inside."""

from __future__ import annotations

import warnings
from typing import Final

from loi_core.support.arrays import Array, namespace, values_may_decide

__all__ = ["RangeWarning", "above_padding", "clip", "clip_pullback", "warn_if_clipped"]

ROUNDING: Final = 1e-6  # tolerance beyond the bounds, in units of their distance: a white float32 reference is inside
MAX_CLIPPED_FRACTION: Final = 0.02  # of the reference without a warning: one or two lights in view


class RangeWarning(UserWarning):
    """A large fraction of a reference lies beyond the bounds of the scales, where all intensities are equal."""


def clip(intensity: Array, low: float, high: float) -> Array:
    """Return `intensity` limited to [low, high]."""
    return namespace(intensity).clip(intensity, low, high)


def clip_pullback(intensity: Array, cotangent: Array, low: float, high: float) -> Array:
    """Return the cotangent of :func:`clip`'s argument, without the components that point further outside.

    The derivative of a clipped value is 0, so an optimiser would leave it where it is. The rule here: strictly below
    `low`, a cotangent is kept if descent along it raises the value; strictly above `high`, if it lowers it; inside and
    on the bounds it is always kept.
    """
    xp = namespace(intensity)
    if values_may_decide(intensity) and bool(xp.min(intensity) >= low) and bool(xp.max(intensity) <= high):
        return cotangent
    outward = ((intensity < low) & (cotangent > 0)) | ((intensity > high) & (cotangent < 0))
    return xp.where(outward, xp.zeros_like(cotangent), cotangent)


def warn_if_clipped(reference: Array, weights: Array | None, bounds: tuple[float, float]) -> None:
    """Warn if `bounds` clip a large fraction of a reference, such as radiance above 1.

    Parameters
    ----------
    reference : array, shape (N, H, W)
    weights : array, shape (N, H, W), optional
        Pixels of weight 0 do not count.
    bounds : tuple of float
    """
    if not values_may_decide(reference):
        return
    low, high = bounds
    rounding = ROUNDING * (high - low)
    xp = namespace(reference)
    clipped = (reference < low - rounding) | (reference > high + rounding)
    if weights is not None:
        clipped = clipped & (weights > 0.0)
    fraction = float(xp.mean(xp.astype(clipped, reference.dtype)))
    if fraction > MAX_CLIPPED_FRACTION:
        minimum, maximum = float(xp.min(reference)), float(xp.max(reference))
        msg = (
            f"{fraction:.0%} of the reference lies beyond the scales' `bounds` ({low:g}, {high:g}) and is clipped, so "
            f"that differences there have no effect; it ranges from {minimum:.3g} to {maximum:.3g}: pass "
            f"ScaleSpace.for_image(height, width, bounds=...), or a `tone`"
        )
        warnings.warn(msg, RangeWarning, stacklevel=2)


def above_padding(clipped: Array, padding: float) -> Array:
    """Return planes within the bounds less the value outside of the image, which becomes 0."""
    return clipped if padding == 0.0 else clipped - padding

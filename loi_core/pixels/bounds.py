"""Intensities within the bounds of a scale space: clipped to them, with a pullback that points back inside."""

from __future__ import annotations

from loi_core.support.arrays import Array, namespace, values_may_decide

__all__ = ["above_padding", "clip", "clip_pullback"]


def clip(intensity: Array, low: float, high: float) -> Array:
    """`intensity` limited to [low, high]."""
    return namespace(intensity).clip(intensity, low, high)


def clip_pullback(intensity: Array, cotangent: Array, low: float, high: float) -> Array:
    """Carry a cotangent back through :func:`clip`, keeping what points back inside.

    A clipped value is flat, so its derivative is 0 and an optimiser would leave it where it is. The rule here:
    strictly below `low`, a cotangent is kept if descent along it raises the value; strictly above `high`, if
    it lowers it; inside and on the bounds it is always kept.
    """
    xp = namespace(intensity)
    if values_may_decide(intensity) and bool(xp.min(intensity) >= low) and bool(xp.max(intensity) <= high):
        return cotangent
    outward = ((intensity < low) & (cotangent > 0)) | ((intensity > high) & (cotangent < 0))
    return xp.where(outward, xp.zeros_like(cotangent), cotangent)


def above_padding(clipped: Array, padding: float) -> Array:
    """Planes within the bounds, less what lies outside of the image: so 0 lies there."""
    return clipped if padding == 0.0 else clipped - padding

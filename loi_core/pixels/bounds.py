"""The range of intensities that scales distinguish: linear between the bounds, logarithmic beyond them."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Final

from loi_core.support.arrays import Array, namespace, values_may_decide

__all__ = ["IntensityRange", "RangeWarning", "above_padding", "warn_if_indistinct", "warn_if_out_of_range"]

ROUNDING: Final = 1e-6  # tolerance beyond the bounds, in units of their distance: a white float32 reference is inside
MAX_COMPRESSED_FRACTION: Final = 0.25  # of the reference without a warning: highlights, lamps and a window in view


class RangeWarning(UserWarning):
    """The bounds of the scales do not suit beta or the reference, and differences of intensity hardly count."""


@dataclass(frozen=True)
class IntensityRange:
    """A map of intensities that leaves those between two bounds, and compresses the others.

    An intensity u above `high` becomes ``high + unit * log(1 + u / unit)``, and likewise below `low`, up to `reach`
    beyond the bound; every larger value counts as `reach`. The map is continuous, with the slope 1 at the bounds.

    Attributes
    ----------
    low, high : float
        The bounds.
    unit : float
        Scale of the logarithm, in units of intensity; 0 clips to the bounds.
    reach : float
        Largest distance from a bound after the map.
    """

    low: float
    high: float
    unit: float = 0.0
    reach: float = 0.0

    def apply(self, intensity: Array) -> Array:
        """Return the mapped intensities, an array like `intensity`; to the bit the same between the bounds."""
        xp = namespace(intensity)
        inside = xp.clip(intensity, self.low, self.high)
        if self.unit == 0.0 or self._contains(intensity):
            return inside
        above, below = self._excess(intensity)
        return inside + (xp.log1p(above * (1.0 / self.unit)) - xp.log1p(below * (1.0 / self.unit))) * self.unit

    def pullback(self, intensity: Array, cotangent: Array) -> Array:
        """Return the cotangent of `intensity` from the cotangent of the mapped intensities.

        Where the map is constant, strictly beyond the reach, the cotangent is 0.
        """
        if self._contains(intensity):
            return cotangent
        xp = namespace(intensity)
        limit = self._limit
        is_constant = (intensity < self.low - limit) | (intensity > self.high + limit)
        slope = cotangent
        if self.unit > 0.0:
            above, below = self._excess(intensity)
            slope = cotangent * (self.unit / (above + below + self.unit))
        return xp.where(is_constant, xp.zeros_like(cotangent), slope)

    @property
    def _limit(self) -> float:
        """Distance from a bound, before the map, that becomes the reach."""
        return 0.0 if self.unit == 0.0 else self.unit * math.expm1(self.reach / self.unit)

    def _contains(self, intensity: Array) -> bool:
        """Return whether all intensities are known to lie between the bounds."""
        xp = namespace(intensity)
        return values_may_decide(intensity) and bool(xp.min(intensity) >= self.low) and bool(
            xp.max(intensity) <= self.high
        )  # fmt: skip

    def _excess(self, intensity: Array) -> tuple[Array, Array]:
        """Return the distances above `high` and below `low`, 0 on the other side, and at most the limit."""
        xp, limit = namespace(intensity), self._limit
        above = xp.clip(intensity, self.high, self.high + limit) - self.high
        below = self.low - xp.clip(intensity, self.low - limit, self.low)
        return above, below


def warn_if_out_of_range(reference: Array, weights: Array | None, bounds: tuple[float, float]) -> None:
    """Warn if a large fraction of a reference lies beyond `bounds`, such as radiance or values up to 255.

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
    outside = (reference < low - rounding) | (reference > high + rounding)
    if weights is not None:
        outside = outside & (weights > 0.0)
    fraction = float(xp.mean(xp.astype(outside, reference.dtype)))
    if fraction > MAX_COMPRESSED_FRACTION:
        minimum, maximum = float(xp.min(reference)), float(xp.max(reference))
        msg = (
            f"{fraction:.0%} of the target lies beyond the scales' `bounds` ({low:g}, {high:g}), where differences "
            f"count by their logarithm only; it ranges from {minimum:.3g} to {maximum:.3g}: pass "
            f"ScaleSpace.for_image(height, width, bounds=...), or a `tone`"
        )
        warnings.warn(msg, RangeWarning, stacklevel=2)


def warn_if_indistinct(beta: float, bounds: tuple[float, float]) -> None:
    """Warn if the smallest tonal scale, `beta`, is wider than `bounds`, so that no intensities are distinguished."""
    low, high = bounds
    if beta > (1.0 + ROUNDING) * (high - low):
        msg = (
            f"`beta` {beta:g} is wider than the scales' `bounds` ({low:g}, {high:g}), so that little more than local "
            f"means of intensity is compared: pass a smaller beta, such as {(high - low) / 8.0:g}, or wider bounds"
        )
        warnings.warn(msg, RangeWarning, stacklevel=5)


def above_padding(compressed: Array, padding: float) -> Array:
    """Return planes after the map of intensities less the value outside of the image, which becomes 0."""
    return compressed if padding == 0.0 else compressed - padding

"""A tone curve for radiance of high dynamic range, with its derivative."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["LogTone", "check_tone"]

PEAK_RANGE: Final = (1e-12, 1e12)  # any unit of radiance; the slope of the curve stays far inside float32's range
COMPRESSION_RANGE: Final = (1e-3, 1e6)


@suggest_keywords
@dataclass(frozen=True)
class LogTone:
    """The mu-law range compressor: linear for dark values, logarithmic for bright ones.

    T(x) = sign(x) log(1 + c |x| / peak) / log(1 + c), with c the compression. It maps [0, peak] onto [0, 1]. Below
    peak / c it is nearly linear, with the slope c / (peak log(1 + c)) at 0; far above, equal ratios of radiance become
    equal differences. Unlike a logarithm it is finite at 0 and odd, so that negative values, which some renderers'
    filters produce, are valid. It has no ceiling: radiance above the peak maps above 1, a firefly of 1e30 with the
    peak 1 and the compression 5000 to 9.1.

    Parameters
    ----------
    peak : float
        The radiance that maps to 1, in the unit of the images, from 1e-12 to 1e12: the brightest radiance to
        distinguish, such as a light source's.
    compression : float
        Ratio of radiance that the logarithm covers, from 1e-3 (nearly linear) to 1e6. The usual value for images of
        high dynamic range, 5000, distinguishes intensities 5000 times darker than the peak.

    Raises
    ------
    OptionError
        If a value is not a number in its range.
    """

    peak: float
    compression: float = 5000.0

    def __post_init__(self) -> None:
        for name, (minimum, maximum) in (("peak", PEAK_RANGE), ("compression", COMPRESSION_RANGE)):
            value = getattr(self, name)
            number = real_number(value)
            if not minimum <= number <= maximum:
                msg = f"`{name}` of a tone curve must be a number from {minimum:g} to {maximum:g}, got {shown(value)}"
                raise OptionError(msg)
            object.__setattr__(self, name, number)

    def apply(self, image: Array) -> Array:
        """Return T(`image`), an array like it; finite for every finite value, and NaN for NaN."""
        xp = namespace(image)
        ones = xp.ones_like(image)
        # Not |x| and sign(x): a framework that differentiates this takes their derivatives at 0 as 0.
        sign = xp.where(image < 0, -ones, ones)
        magnitude = sign * image
        seam = self._seam(image)
        below_seam = xp.log1p(xp.clip(magnitude, max=seam) * self._gain)
        above_seam = xp.log(xp.clip(magnitude, min=seam) / seam)
        return sign * (below_seam + above_seam) * (1.0 / math.log1p(self.compression))

    def pullback(self, image: Array, cotangent: Array) -> Array:
        """Return the cotangent of `image` from the cotangent of T(`image`): times T', positive, and 0 at infinity."""
        xp = namespace(image)
        magnitude = xp.abs(image)
        seam = self._seam(image)
        slope = (self._gain / math.log1p(self.compression)) / (xp.clip(magnitude, max=seam) * self._gain + 1.0)
        return cotangent * slope * (seam / xp.clip(magnitude, min=seam))

    @property
    def _gain(self) -> float:
        return self.compression / self.peak

    def _seam(self, like: Array) -> float:
        """Return the power of two up to which the gain times a value stays in the range of the dtype.

        Above it, the 1 in log(1 + gain x) is far below rounding. The logarithm continues as log(x / seam), which is
        exactly 0 at the seam; the division is exact.
        """
        largest = math.frexp(float(namespace(like).finfo(like.dtype).max))[1] - 1
        return math.ldexp(1.0, largest - max(0, math.frexp(self._gain)[1]))


def check_tone(tone: object) -> LogTone | None:
    """Return `tone` if it is a tone curve or None."""
    if tone is None or isinstance(tone, LogTone):
        return tone
    msg = f"`tone` must be a LogTone or None, got {shown(tone)}"
    raise OptionError(msg)

"""Images for a display: exposure, encoding, signed values as grey, and several images side by side."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.pixels.encoding import Encoding, encode_srgb
from loi_core.support.arrays import Host

__all__ = ["Display", "robust_maximum", "side_by_side", "signed_to_grey"]

WHITE_QUANTILE: Final = 0.99
"""The quantile of a target of high dynamic range that is shown as white; most larger values are light sources."""

LARGEST_QUANTILE: Final = 0.998  # of the magnitudes of a gradient
GAP_PX: Final = 4  # between images side by side


@dataclass(frozen=True)
class Display:
    """An exposure and an encoding for all pictures of a report, so that they can be compared.

    Attributes
    ----------
    exposure : float
        The factor on all values.
    encode : bool
        Whether the values are linear light, to be encoded as sRGB.
    """

    exposure: float = 1.0
    encode: bool = False

    @classmethod
    def of(cls, target: Host, encoding: Encoding | None) -> Display:
        """Return the display for a target; it changes nothing if the target lies in [0, 1] and is not linear."""
        finite = target[np.isfinite(target)]
        white = float(np.quantile(finite, WHITE_QUANTILE)) if finite.size else 1.0
        is_bright = white > 1.0
        return cls(1.0 / white if is_bright else 1.0, encoding == "linear" or (encoding is None and is_bright))

    def show(self, image: Host) -> Host:
        """Return `image` as values in [0, 1] for a display; NaN is black."""
        scaled = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, neginf=0.0) * self.exposure
        shown: Host = np.clip(encode_srgb(scaled) if self.encode else scaled, 0.0, 1.0)
        return shown

    def difference(self, image: Host, target: Host) -> Host:
        """Return the absolute difference of two images as they are shown."""
        difference: Host = np.abs(self.show(image) - self.show(target))
        return difference

    @property
    def note(self) -> str:
        """The changes to the values, for a caption; empty if there are none."""
        changes = ["encoded as sRGB"] if self.encode else []
        if self.exposure != 1.0:
            changes.insert(0, f"exposed by {math.log2(self.exposure):+.1f} stops")
        return f"pictures are {' and '.join(changes)}" if changes else ""


def robust_maximum(values: Host) -> float:
    """Return the largest magnitude of an array without its few largest values."""
    return float(np.quantile(np.abs(values), LARGEST_QUANTILE)) or float(np.max(np.abs(values)))


def signed_to_grey(values: Host, largest: float | None = None) -> Host:
    """Return signed values as intensities in [0, 1]: 0 is mid grey.

    Parameters
    ----------
    values : array
    largest : float, optional
        The value that is white; its negative is black. Default: :func:`robust_maximum` of `values`.
    """
    white = (robust_maximum(values) if largest is None else largest) or 1.0
    shown: Host = np.clip(0.5 + 0.5 * values / white, 0.0, 1.0)
    return shown


def side_by_side(images: Iterable[Host]) -> Host:
    """Return images, shape (H, W, C), next to each other from left to right, with 0 between and below them."""
    images = [np.asarray(image) for image in images]
    if len(images) == 1:
        return images[0]
    height = max(image.shape[0] for image in images)
    width = sum(image.shape[1] for image in images) + GAP_PX * (len(images) - 1)
    strip, left = np.zeros((height, width, images[0].shape[2]), np.result_type(*images)), 0
    for image in images:
        strip[: image.shape[0], left : left + image.shape[1]] = image
        left += image.shape[1] + GAP_PX
    return strip

"""How images are shown: light of any range as values for a display."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.pixels.encoding import Encoding, encode_srgb
from loi_core.support.arrays import Host

__all__ = ["Display"]

WHITE: Final = 0.99
"""The quantile of a target of high dynamic range that is shown as white: of the rest, most are lamps and highlights."""


@dataclass(frozen=True)
class Display:
    """One exposure and curve for all pictures of a report, so that they can be compared.

    Attributes
    ----------
    exposure : float
        What values are multiplied by.
    encode : bool
        Whether they are linear light, which is encoded as sRGB.
    """

    exposure: float = 1.0
    encode: bool = False

    @classmethod
    def of(cls, target: Host, encoding: Encoding | None) -> Display:
        """The one for a target: as it is if it lies in [0, 1] and is not known to be linear."""
        finite = target[np.isfinite(target)]
        white = float(np.quantile(finite, WHITE)) if finite.size else 1.0
        high = white > 1.0
        return cls(1.0 / white if high else 1.0, encoding == "linear" or (encoding is None and high))

    def show(self, image: Host) -> Host:
        """`image` as values in [0, 1] for a display; NaN is black."""
        scaled = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, neginf=0.0) * self.exposure
        shown: Host = np.clip(encode_srgb(scaled) if self.encode else scaled, 0.0, 1.0)
        return shown

    def difference(self, image: Host, target: Host) -> Host:
        """How far two images are apart as they are shown."""
        apart: Host = np.abs(self.show(image) - self.show(target))
        return apart

    @property
    def note(self) -> str:
        """What has been done to the values, for a caption; empty if nothing has."""
        parts = ["encoded as sRGB"] if self.encode else []
        if self.exposure != 1.0:
            parts.insert(0, f"exposed by {math.log2(self.exposure):+.1f} stops")
        return f"pictures are {' and '.join(parts)}" if parts else ""

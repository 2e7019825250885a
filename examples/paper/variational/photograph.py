"""Simulate a photograph: a blurring, vignetting lens, a noisy sensor, and a file of 8 bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core.method.blurs import gaussian_blur
from loi_core.pixels.encoding import encode_srgb

__all__ = ["Photograph"]


@dataclass(frozen=True)
class Photograph:
    """Lens and sensor of a camera.

    Attributes
    ----------
    blur : float
        Standard deviation of the lens blur, in pixels of the photograph.
    vignetting : float
        Share of the light that is lost in the corners.
    full_well : float
        Expected number of electrons at a value of 1, for the shot noise.
    read_noise : float
        Standard deviation of the read noise, as a share of a value of 1.
    """

    blur: float = 0.6
    vignetting: float = 0.05
    full_well: float = 4000.0
    read_noise: float = 0.003

    def of(self, light: np.ndarray[Any, Any], *, seed: int) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Return the photograph, shape (H, W, 3), sRGB in [0, 1] with 8 bits.

        `light` is linear, at twice the resolution: shape (2 H, 2 W, 3).
        """
        height, width = light.shape[0] // 2, light.shape[1] // 2
        planes = np.moveaxis(np.asarray(light, dtype=np.float64), -1, 0)
        blurred = gaussian_blur(2 * height, 2 * width, 2.0 * self.blur, "reflect", like=planes).apply(planes)
        fine = np.moveaxis(np.asarray(blurred), 0, -1)
        exposed = fine.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        y, x = np.meshgrid(np.linspace(-1.0, 1.0, height), np.linspace(-1.0, 1.0, width), indexing="ij")
        exposed = exposed * (1.0 - self.vignetting * (x**2 + y**2)[..., None] / 2.0)
        rng = np.random.default_rng(seed)
        read = rng.poisson(self.full_well * np.maximum(exposed, 0.0)) / self.full_well
        read = read + self.read_noise * rng.standard_normal(read.shape)
        encoded = np.asarray(encode_srgb(np.clip(read, 0.0, 1.0)))
        return (np.rint(255.0 * encoded) / 255.0).astype(np.float32)

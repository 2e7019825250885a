"""Crops of the photographs that scikit-image ships."""

from __future__ import annotations

from typing import Final

import numpy as np
from PIL import Image

from examples.convergence.case import random_crop
from loi_core.support.arrays import Host

__all__ = ["NAMES", "crop_of", "image_of"]

NAMES: Final = (
    "astronaut",
    "chelsea",
    "coffee",
    "rocket",
    "hubble_deep_field",
    "retina",
    "immunohistochemistry",
    "camera",
    "coins",
    "moon",
    "gravel",
    "clock",
)
"""Functions of ``skimage.data`` whose files come with the package."""


def image_of(name: str) -> Image.Image:
    """Return a photograph in RGB."""
    import skimage.data

    pixels: Host = getattr(skimage.data, name)()
    return Image.fromarray(pixels).convert("RGB")


def crop_of(name: str, height: int, width: int, rng: np.random.Generator) -> Host:
    """Return a random crop, shape (height, width, 3), sRGB."""
    return random_crop(image_of(name), height, width, rng)

"""Pairs of images: disks that do not overlap, and random textures."""

from __future__ import annotations

import numpy as np

from tests.helpers import Host

__all__ = ["disks", "textures"]


def disks(height: int = 48, width: int = 64) -> tuple[Host, Host]:
    """Return an orange disk on blue at two positions that do not overlap, shape (H, W, 3)."""
    rows, columns = np.indices((height, width))
    images = []
    for centre in (0.2, 0.75):
        distance = np.hypot(rows - 0.5 * height, columns - centre * width)
        inside = np.clip(0.12 * width + 0.5 - distance, 0.0, 1.0)[..., None]
        images.append(inside * np.array([0.9, 0.5, 0.1]) + (1.0 - inside) * np.array([0.1, 0.2, 0.5]))
    return images[0], images[1]


def textures(height: int, width: int, channels: int = 3, seed: int = 0) -> tuple[Host, Host]:
    """Return two images of random pixels, shape (H, W, C)."""
    first, second = np.random.default_rng(seed).uniform(0.02, 0.98, (2, height, width, channels))
    return first, second

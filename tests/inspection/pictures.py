"""Two pictures that overlap nowhere, and larger ones with texture."""

from __future__ import annotations

import numpy as np

from tests.helpers import Host

__all__ = ["disks", "textures"]


def disks(height: int = 48, width: int = 64) -> tuple[Host, Host]:
    """An orange disk on blue, and the same at another place, shape (H, W, 3)."""
    rows, columns = np.indices((height, width))
    found = []
    for place in (0.2, 0.75):
        away = np.hypot(rows - 0.5 * height, columns - place * width)
        inside = np.clip(0.12 * width + 0.5 - away, 0.0, 1.0)[..., None]
        found.append(inside * np.array([0.9, 0.5, 0.1]) + (1.0 - inside) * np.array([0.1, 0.2, 0.5]))
    return found[0], found[1]


def textures(height: int, width: int, channels: int = 3, seed: int = 0) -> tuple[Host, Host]:
    """Random pixels, and others, shape (H, W, C)."""
    first, second = np.random.default_rng(seed).uniform(0.02, 0.98, (2, height, width, channels))
    return first, second

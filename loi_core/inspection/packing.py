"""Local histograms on a grid of pixels, packed for the script of the page."""

from __future__ import annotations

import base64
import zlib
from typing import Any, Final

import numpy as np

from loi_core.inspection.maps import histograms_at
from loi_core.inspection.pair import Pair

__all__ = ["packed_histograms"]

MOST_SHARES: Final = 1_500_000  # bytes of histograms, before they are packed
POINTS: Final = (96, 4000)  # where there are histograms: at least, and at most
COLOURS: Final = {1: ("grey",), 3: ("red", "green", "blue")}


def packed_histograms(pair: Pair) -> dict[str, Any]:
    """Local histograms of both images on a grid of pixels, as the script of the page takes them.

    ``packed`` holds a byte for each share, ``255 sqrt(share)`` rounded, in the order group (sigma and beta), picture,
    extent, channel, level, row, column; then differences from each byte to the next, modulo 256; then zlib, then
    base64. ``rows`` and ``columns`` are pixels of the files.
    """
    scales, channels = pair.computed_scales, pair.image.shape[2]
    pairs = [(sigma, beta) for sigma in scales.sigma for beta in scales.beta]
    each = sum(2 * len(scales.alpha) * channels * scales.level_count(beta) for _, beta in pairs)
    least, most = POINTS
    rows, columns = _grid(pair.image.shape[0], pair.image.shape[1], min(most, max(least, MOST_SHARES // each)))
    parts = [
        np.rint(255.0 * np.sqrt(histograms_at(image, scales, sigma, beta, rows, columns).clip(0.0, 1.0))).ravel()
        for sigma, beta in pairs
        for image in (pair.image, pair.reference)
    ]
    shares = np.concatenate(parts).astype(np.uint8)
    differences = np.diff(shares, prepend=np.uint8(0))
    files_pixels = [
        [min(size - 1, one * pair.factor + pair.factor // 2) for one in places]
        for places, size in ((rows, pair.height), (columns, pair.width))
    ]
    low, high = pair.scales.bounds
    widest = 2.0 * max(scales.beta)
    return {
        "names": pair.names,
        "width": pair.width,
        "height": pair.height,
        "rows": files_pixels[0],
        "columns": files_pixels[1],
        "channels": COLOURS[channels],
        "bounds": [low, high],
        "shown": [low - widest, high + widest],
        "p": scales.p,
        "groups": [
            {
                "sigma": sigma,
                "beta": beta,
                "alphas": pair.scales.alpha,
                "levels": scales.levels(beta).tolist(),
                "spacing": scales.spacing(beta),
            }
            for sigma in pair.scales.sigma
            for beta in scales.beta
        ],
        "packed": base64.b64encode(zlib.compress(differences.tobytes(), 9)).decode("ascii"),
    }


def _grid(height: int, width: int, points: int) -> tuple[list[int], list[int]]:
    """About so many pixels, evenly over an image: their rows and columns."""
    step = max(1.0, (height * width / points) ** 0.5)

    def places(size: int) -> list[int]:
        count = max(1, min(size, int(size / step)))
        return sorted({int((index + 0.5) * size / count) for index in range(count)})

    return places(height), places(width)

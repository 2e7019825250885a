"""Local histograms on a grid of pixels, packed for the script of the page."""

from __future__ import annotations

import base64
import zlib
from typing import Any, Final

import numpy as np

from loi_core.inspection.maps import histograms_at
from loi_core.inspection.pair import Pair

__all__ = ["packed_histograms"]

MAX_PACKED_BYTES: Final = 1_500_000  # of all histograms before compression
MIN_POINTS: Final = 96
MAX_POINTS: Final = 4000
CHANNEL_NAMES: Final = {1: ("grey",), 3: ("red", "green", "blue")}


def packed_histograms(pair: Pair) -> dict[str, Any]:
    """Return local histograms of both images on a grid of pixels, as plain values for JSON.

    Returns
    -------
    dict
        ``rows`` and ``columns`` are pixels of the files. ``packed`` has a byte for each fraction of a histogram,
        ``255 sqrt(fraction)`` rounded, in the order group (sigma and beta), image, extent, channel, level, row,
        column. The bytes are replaced by their differences modulo 256, compressed by zlib and encoded in base64.
    """
    scales, channels = pair.computed_scales, pair.image.shape[2]
    groups = [(sigma, beta) for sigma in scales.sigma for beta in scales.beta]
    point_bytes = sum(2 * len(scales.alpha) * channels * scales.level_count(beta) for _, beta in groups)
    points = min(MAX_POINTS, max(MIN_POINTS, MAX_PACKED_BYTES // point_bytes))
    rows, columns = _grid(pair.image.shape[0], pair.image.shape[1], points)
    roots = [
        np.rint(255.0 * np.sqrt(histograms_at(image, scales, sigma, beta, rows, columns).clip(0.0, 1.0))).ravel()
        for sigma, beta in groups
        for image in (pair.image, pair.reference)
    ]
    differences = np.diff(np.concatenate(roots).astype(np.uint8), prepend=np.uint8(0))
    lower, upper = pair.scales.bounds
    tail = 2.0 * max(scales.beta)
    return {
        "names": pair.names,
        "width": pair.width,
        "height": pair.height,
        "rows": [min(pair.height - 1, row * pair.factor + pair.factor // 2) for row in rows],
        "columns": [min(pair.width - 1, column * pair.factor + pair.factor // 2) for column in columns],
        "channels": CHANNEL_NAMES[channels],
        "bounds": [lower, upper],
        "shown": [lower - tail, upper + tail],
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
    """Return the rows and columns of about this many pixels, evenly over an image."""
    step = max(1.0, (height * width / points) ** 0.5)

    def positions(size: int) -> list[int]:
        count = max(1, min(size, int(size / step)))
        return sorted({int((index + 0.5) * size / count) for index in range(count)})

    return positions(height), positions(width)

"""Keeping disks whole in the frame and apart from one another: where they are hidden, they have no gradient."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.renderers.rasterization import IndexArray
from loi_core.renderers.validation import FloatArray

__all__ = ["candidate_pairs", "separate_disks"]

SWEEPS: Final = 10  # chains of touching disks need a few
GOLDEN_ANGLE: Final = 2.399963
COINCIDENT: Final = 1e-9  # pixels; nearer than this the line through two centres says nothing


def separate_disks(positions: FloatArray, radii: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Centres moved by little that brings every disk into the frame and parts each overlapping pair.

    Parameters
    ----------
    positions : array, shape (n, 2)
        Centres (x, y) in pixels.
    radii : array, shape (n,)
        In pixels.
    size : (int, int)
        Height and width of the frame in pixels.

    Notes
    -----
    The cost grows with the pairs that are near one another, not with all pairs. A disk larger than the frame is put
    into its middle.
    """
    frame = np.array(size[::-1], dtype=np.float64)
    margin = np.minimum(radii[:, None], 0.5 * frame)
    positions = _within(positions, margin, frame)
    for _ in range(SWEEPS):
        first, second = candidate_pairs(positions, radii)
        apart = positions[first] - positions[second]
        distance = np.hypot(apart[:, 0], apart[:, 1])
        overlap = radii[first] + radii[second] - distance
        met = np.flatnonzero(overlap > 0.0)
        if not len(met):
            break
        first, second, apart, distance = first[met], second[met], apart[met], distance[met, None]
        # Two disks in exactly the same place have no direction to part in: each pair gets one of its own.
        along = apart / np.maximum(distance, COINCIDENT)
        direction = np.where(distance < COINCIDENT, _spare(first, second), along)
        push = 0.5 * overlap[met, None] * direction
        ends, pushes = np.concatenate([first, second]), np.concatenate([push, -push])
        moved = np.stack([np.bincount(ends, pushes[:, axis], len(radii)) for axis in range(2)], axis=-1)
        positions = _within(positions + moved, margin, frame)
    return positions


def _within(positions: FloatArray, margin: FloatArray, frame: FloatArray) -> FloatArray:
    kept: FloatArray = np.clip(positions, margin, frame - margin)
    return kept


def candidate_pairs(positions: FloatArray, radii: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Every pair of disks, once, that is near enough along x to overlap: indices, two arrays of one length.

    Parameters
    ----------
    positions, radii
        As :func:`separate_disks` takes them.
    """
    order = np.argsort(positions[:, 0], kind="stable")
    columns = positions[order, 0]
    reach = radii[order] + radii.max(initial=0.0)
    after = np.arange(1, len(order) + 1)
    counts = np.maximum(np.searchsorted(columns, columns + reach, side="right") - after, 0)
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    return order[first], order[second]


def _spare(first: IndexArray, second: IndexArray) -> FloatArray:
    """A direction of its own for each pair of disks."""
    angles = GOLDEN_ANGLE * np.stack([first, second])
    difference = np.stack([np.cos(angles[0]) - np.cos(angles[1]), np.sin(angles[0]) - np.sin(angles[1])], axis=-1)
    length: FloatArray = np.linalg.norm(difference, axis=-1, keepdims=True)
    spread: FloatArray = difference / np.maximum(length, 1e-12)
    return spread

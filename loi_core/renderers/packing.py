"""Packing of disks: each disk lies in the frame and overlaps no other, since hidden disks have no gradient."""

from __future__ import annotations

from typing import Final

import numpy as np

from loi_core.renderers.rasterization import IndexArray
from loi_core.renderers.validation import FloatArray

__all__ = ["candidate_pairs", "separate_disks"]

MAX_SWEEPS: Final = 10  # chains of touching disks need a few
GOLDEN_ANGLE: Final = 2.399963  # radians
MIN_DISTANCE_PX: Final = 1e-9  # below it the direction between two centres is undefined


def separate_disks(positions: FloatArray, radii: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return centres with every disk in the frame and overlapping pairs separated, by small displacements.

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
    The cost grows with the number of neighbouring pairs, not with all pairs. A disk larger than the frame is centred.
    """
    frame = np.array(size[::-1], dtype=np.float64)
    margin = np.minimum(radii[:, None], 0.5 * frame)
    positions = _clip_to_frame(positions, margin, frame)
    for _ in range(MAX_SWEEPS):
        first, second = candidate_pairs(positions, radii)
        offset = positions[first] - positions[second]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        overlap = radii[first] + radii[second] - distance
        overlapping = np.flatnonzero(overlap > 0.0)
        if not len(overlapping):
            break
        first, second, offset, distance = (
            first[overlapping],
            second[overlapping],
            offset[overlapping],
            distance[overlapping, None],
        )
        # Coincident disks have no direction of separation: each pair gets a different one.
        unit_offset = offset / np.maximum(distance, MIN_DISTANCE_PX)
        direction = np.where(distance < MIN_DISTANCE_PX, _fallback_directions(first, second), unit_offset)
        shift = 0.5 * overlap[overlapping, None] * direction
        disks, shifts = np.concatenate([first, second]), np.concatenate([shift, -shift])
        displacement = np.stack([np.bincount(disks, shifts[:, axis], len(radii)) for axis in range(2)], axis=-1)
        positions = _clip_to_frame(positions + displacement, margin, frame)
    return positions


def _clip_to_frame(positions: FloatArray, margin: FloatArray, frame: FloatArray) -> FloatArray:
    clipped: FloatArray = np.clip(positions, margin, frame - margin)
    return clipped


def candidate_pairs(positions: FloatArray, radii: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Return the indices of all pairs of disks that are close enough along x to overlap, each pair once.

    Parameters
    ----------
    positions, radii
        As for :func:`separate_disks`.
    """
    order = np.argsort(positions[:, 0], kind="stable")
    columns = positions[order, 0]
    reach = radii[order] + radii.max(initial=0.0)
    next_index = np.arange(1, len(order) + 1)
    counts = np.maximum(np.searchsorted(columns, columns + reach, side="right") - next_index, 0)
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    return order[first], order[second]


def _fallback_directions(first: IndexArray, second: IndexArray) -> FloatArray:
    """Return a different unit vector for each pair of disks."""
    angles = GOLDEN_ANGLE * np.stack([first, second])
    difference = np.stack([np.cos(angles[0]) - np.cos(angles[1]), np.sin(angles[0]) - np.sin(angles[1])], axis=-1)
    length: FloatArray = np.linalg.norm(difference, axis=-1, keepdims=True)
    directions: FloatArray = difference / np.maximum(length, 1e-12)
    return directions

"""What many disks cover, as a flat list of fragments: one for each pixel and disk that meet.

So the cost grows with the pixels that are covered, not with disks times pixels; and only where an edge passes through
a pixel is an area computed, since elsewhere it is 1 and does not change.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from loi_core.renderers.validation import FloatArray

__all__ = ["Fragments", "IndexArray", "peel_layers", "rasterize_disks"]

IndexArray: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


@dataclass(frozen=True)
class Fragments:
    """Fragments in the order in which they are painted: layer by layer, each of which holds a pixel at most once.

    Attributes
    ----------
    owner : array, shape (m,)
        Which disk.
    rows, columns : array, shape (m,)
        Which pixel.
    on_edge : array of bool, shape (m,)
        Whether the disk's edge passes through the pixel; if not, the disk covers all of it.
    layers : tuple of slice
        The fragments of each layer, lowest first.
    """

    owner: IndexArray
    rows: IndexArray
    columns: IndexArray
    on_edge: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    layers: tuple[slice, ...]


def rasterize_disks(positions: FloatArray, radii: FloatArray, size: tuple[int, int]) -> Fragments:
    """The fragments of `n` disks, the later ones on top, on a canvas of `size` pixels, height and width.

    Parameters
    ----------
    positions : array, shape (n, 2)
        Centres (x, y) in pixels.
    radii : array, shape (n,)
        In pixels; a disk of 0 or less has no fragments.
    """
    height, width = size
    first_column, columns_of = _touched(positions[:, 0], radii, width)
    first_row, rows_of = _touched(positions[:, 1], radii, height)
    counts = rows_of * columns_of
    owner = np.repeat(np.arange(len(radii)), counts)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    across = np.maximum(columns_of[owner], 1)
    rows, columns = first_row[owner] + place // across, first_column[owner] + place % across
    x, y = np.abs(columns + 0.5 - positions[owner, 0]), np.abs(rows + 0.5 - positions[owner, 1])
    nearest = np.hypot(np.maximum(x - 0.5, 0.0), np.maximum(y - 0.5, 0.0))
    kept = np.flatnonzero(nearest < radii[owner])
    on_edge = np.hypot(x[kept] + 0.5, y[kept] + 0.5) > radii[owner[kept]]
    owner, rows, columns = owner[kept], rows[kept], columns[kept]
    order, layers = peel_layers(rows * width + columns)
    return Fragments(owner[order], rows[order], columns[order], on_edge[order], layers)


def peel_layers(pixels: IndexArray) -> tuple[IndexArray, tuple[slice, ...]]:
    """How to sort fragments, given lowest first by their `pixels`, into layers that hold a pixel at most once."""
    depth = _depth(pixels)
    order = np.argsort(depth, kind="stable")
    ends = np.cumsum(np.bincount(depth)) if len(depth) else [0]
    layers = tuple(slice(int(start), int(stop)) for start, stop in itertools.pairwise([0, *ends]) if stop > start)
    return order, layers


def _touched(centres: FloatArray, radii: FloatArray, size: int) -> tuple[IndexArray, IndexArray]:
    """First pixel of an axis that each [centre - radius, centre + radius] meets, and how many."""
    reach = np.maximum(radii, 0.0)
    low = np.floor(np.clip(centres - reach, 0.0, size)).astype(np.int64)
    high = np.ceil(np.clip(centres + reach, 0.0, size)).astype(np.int64)
    return low, np.where(reach > 0.0, np.maximum(high - low, 0), 0)


def _depth(pixels: IndexArray) -> IndexArray:
    """How many entries before each of `pixels` are equal to it."""
    order = np.argsort(pixels, kind="stable")
    ordered = pixels[order]
    fresh = np.ones(len(pixels), dtype=bool)
    fresh[1:] = ordered[1:] != ordered[:-1]
    starts = np.flatnonzero(fresh)
    depth = np.empty(len(pixels), dtype=np.int64)
    depth[order] = np.arange(len(pixels)) - starts[np.cumsum(fresh) - 1]
    return depth

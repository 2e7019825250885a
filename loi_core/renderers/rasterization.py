"""Rasterization of disks into a flat list of fragments, one for each pair of a pixel and a disk that intersect.

The cost grows with the number of covered pixels, not with disks times pixels. Areas are computed only for pixels on an
edge, since the coverage of interior pixels is constantly 1.
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
    """Fragments in painting order: layer by layer, with each pixel at most once in a layer.

    Attributes
    ----------
    owner : array, shape (m,)
        Index of the disk.
    rows, columns : array, shape (m,)
        Pixel.
    on_edge : array of bool, shape (m,)
        Whether the edge of the disk intersects the pixel; otherwise the disk covers the whole pixel.
    layers : tuple of slice
        Fragments of each layer, bottom layer first.
    """

    owner: IndexArray
    rows: IndexArray
    columns: IndexArray
    on_edge: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    layers: tuple[slice, ...]


def rasterize_disks(positions: FloatArray, radii: FloatArray, size: tuple[int, int]) -> Fragments:
    """Rasterize disks on a canvas of `size` pixels, height and width; later disks are on top.

    Parameters
    ----------
    positions : array, shape (n, 2)
        Centres (x, y) in pixels.
    radii : array, shape (n,)
        In pixels; a disk with a radius of 0 or less has no fragments.
    """
    height, width = size
    first_column, column_counts = _pixel_range(positions[:, 0], radii, width)
    first_row, row_counts = _pixel_range(positions[:, 1], radii, height)
    counts = row_counts * column_counts
    owner = np.repeat(np.arange(len(radii)), counts)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    width_of_box = np.maximum(column_counts[owner], 1)
    rows, columns = first_row[owner] + offset // width_of_box, first_column[owner] + offset % width_of_box
    x, y = np.abs(columns + 0.5 - positions[owner, 0]), np.abs(rows + 0.5 - positions[owner, 1])
    min_distance = np.hypot(np.maximum(x - 0.5, 0.0), np.maximum(y - 0.5, 0.0))
    covered = np.flatnonzero(min_distance < radii[owner])
    on_edge = np.hypot(x[covered] + 0.5, y[covered] + 0.5) > radii[owner[covered]]
    owner, rows, columns = owner[covered], rows[covered], columns[covered]
    order, layers = peel_layers(rows * width + columns)
    return Fragments(owner[order], rows[order], columns[order], on_edge[order], layers)


def peel_layers(pixels: IndexArray) -> tuple[IndexArray, tuple[slice, ...]]:
    """Sort fragments into layers with each pixel at most once, as in depth peeling.

    Parameters
    ----------
    pixels : array, shape (m,)
        Pixel index of each fragment, bottom fragments first.

    Returns
    -------
    order : array, shape (m,)
        Indices that sort the fragments by layer.
    layers : tuple of slice
        Layers of the sorted fragments, bottom layer first.
    """
    depth = _depth(pixels)
    order = np.argsort(depth, kind="stable")
    stops = np.cumsum(np.bincount(depth)) if len(depth) else [0]
    layers = tuple(slice(int(start), int(stop)) for start, stop in itertools.pairwise([0, *stops]) if stop > start)
    return order, layers


def _pixel_range(centres: FloatArray, radii: FloatArray, size: int) -> tuple[IndexArray, IndexArray]:
    """Return the first pixel and the number of pixels that intersect [centre - radius, centre + radius] on one axis."""
    reach = np.maximum(radii, 0.0)
    start = np.floor(np.clip(centres - reach, 0.0, size)).astype(np.int64)
    stop = np.ceil(np.clip(centres + reach, 0.0, size)).astype(np.int64)
    return start, np.where(reach > 0.0, np.maximum(stop - start, 0), 0)


def _depth(pixels: IndexArray) -> IndexArray:
    """Return the number of equal entries before each entry of `pixels`."""
    order = np.argsort(pixels, kind="stable")
    ordered = pixels[order]
    is_first = np.ones(len(pixels), dtype=bool)
    is_first[1:] = ordered[1:] != ordered[:-1]
    starts = np.flatnonzero(is_first)
    depth = np.empty(len(pixels), dtype=np.int64)
    depth[order] = np.arange(len(pixels)) - starts[np.cumsum(is_first) - 1]
    return depth

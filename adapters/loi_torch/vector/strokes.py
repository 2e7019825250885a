"""The outlines of strokes: rings at half the stroke's width beside the rings that are stroked.

An open outline is followed there and back, as one ring whose ends are corners of 180 degrees; a closed one once in each
direction. So all that is needed is one side of a directed ring.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor

from loi_core.renderers.rasterization import IndexArray
from loi_core.renderers.validation import FloatArray
from loi_core.support.arrays import to_numpy
from loi_torch.vector.outlines import TOLERANCE, Ring, Rings, ragged_arange
from loi_torch.vector.shapes import Paint

__all__ = ["stroke_points"]

COINCIDENT_PX: Final = 1e-9  # points closer than this define no direction
MAX_MITER_WIDTHS: Final = 4.0  # the default of SVG
MITER, BEVEL, PIVOT, SQUARE, ROUND = range(5)


def stroke_points(
    rings: Rings, strokes: list[tuple[Paint, list[Ring]]], widths: Tensor
) -> tuple[Tensor, IndexArray, IndexArray]:
    """Return the outlines of strokes, differentiable by points and widths.

    Parameters
    ----------
    rings : Rings
        All outlines.
    strokes : list of (Paint, list of Ring)
        For each stroke its style and its outlines.
    widths : tensor, shape (n,), float64
        Widths of the strokes in pixels.

    Returns
    -------
    points : tensor, shape (k, 2)
    stroke : array, shape (r,)
        Index of the stroke that each ring bounds; a stroke without length has no ring.
    ends : array, shape (r,)
        Past the last point of each ring.
    """
    host = to_numpy(rings.points)
    turns, styles, numbers, ends = [], [], [], []
    for index, (paint, stroked) in enumerate(strokes):
        for ring in stroked:
            for directed_ring, is_end in _ways(ring, host):
                turns.append(np.stack([np.roll(directed_ring, 1), directed_ring, np.roll(directed_ring, -1)]))
                styles.append((index, paint))
                numbers.append(len(directed_ring))
                ends.append(is_end)
    device = rings.points.device
    if not turns:
        return (
            torch.zeros((0, 2), dtype=torch.float64, device=device),
            np.zeros(0, dtype=np.int64),
            np.zeros(0, dtype=np.int64),
        )
    previous, at, following = np.concatenate(turns, axis=1)
    ring_of = np.repeat(np.arange(len(numbers)), numbers)
    strokes_of_rings = np.array([index for index, _ in styles])
    stroke_of = strokes_of_rings[ring_of]
    half_host = 0.5 * np.abs(to_numpy(widths))[stroke_of]
    end = np.concatenate(ends)
    mode, counts = _modes(host, previous, at, following, half_host, end, rings.corner[at], styles, ring_of)
    corner, place = ragged_arange(counts)
    fraction = torch.as_tensor(place / np.maximum(counts[corner] - 1, 1), device=device)

    where = [torch.as_tensor(indices, device=device) for indices in (previous, at, following)]
    first, middle, last = (rings.points.index_select(0, indices) for indices in where)
    into, out = _unit(middle - first), _unit(last - middle)
    dot = torch.sum(into * out, dim=1)
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    modes = torch.as_tensor(mode, device=device)
    ends_at = torch.as_tensor(end, device=device)
    angle = torch.where(ends_at, torch.full_like(dot, torch.pi), torch.atan2(cross, dot))
    mitered = modes == MITER
    longer = 1.0 / torch.where(mitered, 1.0 + dot, torch.ones_like(dot))

    expand = torch.as_tensor(corner, device=device)
    join_mode = modes[expand]
    swing = angle.index_select(0, expand) * fraction
    early, late, half_way = (fraction < 0.25), (fraction > 0.75), join_mode == PIVOT
    stay = torch.where(early, 1.0, torch.where(late | half_way, 0.0, 0.5)).to(dot)
    come = torch.where(late, 1.0, torch.where(early | half_way, 0.0, 0.5)).to(dot)
    miter = longer.index_select(0, expand)
    by_into = torch.where(join_mode == ROUND, torch.cos(swing), torch.where(join_mode == MITER, miter, stay))
    by_out = torch.where(join_mode == ROUND, torch.zeros_like(swing), torch.where(join_mode == MITER, miter, come))
    forward = torch.where(join_mode == ROUND, torch.sin(swing), (join_mode == SQUARE).to(dot))
    into, out = into.index_select(0, expand), out.index_select(0, expand)
    offset = by_into[:, None] * _beside(into) + by_out[:, None] * _beside(out) + forward[:, None] * into
    half = 0.5 * torch.abs(widths).index_select(0, torch.as_tensor(stroke_of[corner], device=device))
    ends_of_rings = np.cumsum(counts)[np.cumsum(numbers) - 1]
    return middle.index_select(0, expand) + half[:, None] * offset, strokes_of_rings, ends_of_rings


def _ways(ring: Ring, host: FloatArray) -> list[tuple[IndexArray, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]]:
    """Return the directed rings along `ring` without repeated points, and the mask of end points."""
    index = np.arange(ring.first, ring.beyond)
    is_distinct = np.linalg.norm(host[index] - host[np.roll(index, 1)], axis=1) > COINCIDENT_PX
    if not ring.closed:
        is_distinct[:1] = True
    index = index[is_distinct]
    if len(index) < 2:
        return []
    if ring.closed:
        none = np.zeros(len(index), dtype=bool)
        return [(index, none), (index[::-1], none)]
    there_and_back = np.concatenate([index, index[-2:0:-1]])
    is_end = np.zeros(len(there_and_back), dtype=bool)
    is_end[[0, len(index) - 1]] = True
    return [(there_and_back, is_end)]


def _modes(
    host: FloatArray,
    previous: IndexArray,
    at: IndexArray,
    following: IndexArray,
    half: FloatArray,
    end: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    is_corner: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    styles: list[tuple[int, Paint]],
    ring_of: IndexArray,
) -> tuple[IndexArray, IndexArray]:
    """Return the join of each point and its number of points."""
    into, out = host[at] - host[previous], host[following] - host[at]
    lengths = np.linalg.norm(into, axis=1), np.linalg.norm(out, axis=1)
    into, out = into / lengths[0][:, None], out / lengths[1][:, None]
    dot = np.sum(into * out, axis=1)
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    caps = np.array([{"butt": BEVEL, "square": SQUARE, "round": ROUND}[paint.cap] for _, paint in styles])[ring_of]
    joins = np.array([{"miter": MITER, "bevel": BEVEL, "round": ROUND}[paint.join] for _, paint in styles])[ring_of]
    outer = np.where(is_corner, joins, MITER)
    sharp = MAX_MITER_WIDTHS**2 * (1.0 + dot) < 2.0
    outer = np.where((outer == MITER) & sharp, np.where(is_corner, BEVEL, ROUND), outer)
    # On the inner side edges end where they meet, unless they are too short.
    fits = half * np.abs(cross) <= 0.5 * np.minimum(*lengths) * (1.0 + dot)
    inner = np.where(fits & ~sharp, MITER, PIVOT)
    mode = np.where(end, caps, np.where(cross >= 0.0, outer, inner))
    angle = np.where(end, np.pi, np.abs(np.arctan2(cross, dot)))
    step = np.sqrt(8.0 * TOLERANCE / np.maximum(half, 0.1))
    counts = np.array([1, 2, 3, 2, 0])[mode]
    return mode, np.where(mode == ROUND, np.ceil(angle / step).astype(np.int64) + 2, counts)


def _unit(vectors: Tensor) -> Tensor:
    unit: Tensor = vectors / torch.linalg.vector_norm(vectors, dim=1, keepdim=True)
    return unit


def _beside(direction: Tensor) -> Tensor:
    """Return `direction` rotated by a right angle to the painted side."""
    return torch.stack([direction[:, 1], -direction[:, 0]], dim=1)

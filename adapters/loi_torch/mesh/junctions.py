"""What parts of edges end at: borders of pixels, corners, other edges, and surfaces that they run into.

The ends decide how a part changes as things move. A part that is cut off by the border of its pixel slides along that
border; one that disappears behind an outline ends where the two cross, wherever both move. With that, image and
gradient agree where outlines meet. The outline in front is split there, since what lies behind it changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch

from loi_torch.mesh.coverage import nearest_share
from loi_torch.mesh.projected import FloatArray, IndexArray, Projected, Seen

__all__ = ["CORNER", "CROSSING", "EDGE", "HORIZONTAL", "VERTICAL", "Parts", "crossing_stops", "settled"]

CORNER: Final = 0  # the end of the edge itself
VERTICAL: Final = 1  # a border of the pixel, x constant
HORIZONTAL: Final = 2  # likewise, y constant
EDGE: Final = 3  # another edge, between two vertices
CROSSING: Final = 4  # the line where two triangles cut into each other

APART: Final = 1e-3  # pixels between where a part was seen to end and where it ends at something
SAME: Final = 1e-6  # pixels between what is taken for one point


@dataclass(frozen=True)
class Parts:
    """Parts of edges that show.

    Attributes
    ----------
    edge, span, pixel, sides
        As those of :class:`Seen`.
    stops : array of int, shape (f, 2, 3)
        What each end is at: one of the kinds of this module, and the two vertices or triangles that it is of.
    """

    edge: IndexArray
    span: FloatArray
    pixel: IndexArray
    sides: IndexArray
    stops: IndexArray


def settled(scene: Projected, seen: Seen) -> Parts:
    """The parts of edges that show, with what they end at, split where what is behind them changes."""
    shape = scene.topology
    span, stops = seen.span.copy(), np.zeros((len(seen.edge), 2, 3), np.int32)
    first, last = (scene.corners[shape.ends[seen.edge, k]] for k in (0, 1))
    for end in (0, 1):
        stops[:, end, 0] = _borders(first, last, span[:, end])
    part, side = np.nonzero(seen.beyond >= 0)
    if not len(part):
        return Parts(seen.edge, span, seen.pixel, seen.sides, stops)
    hiding = seen.beyond[part, side]
    a, b = first[part], last[part]
    seen_at = span[part, side]
    ends = shape.ends[seen.edge[part]]
    candidates = [_meeting(a, b, *_line(scene, shape.faces[hiding], k)) for k in range(3)]
    own = np.where(_holds(shape.joined[seen.sides[part, 0].clip(0)], shape.joined_ends[seen.edge[part]]), 0, 1)
    owner = seen.sides[part, own]
    plane = _planes(scene, hiding)
    rise = scene.depth[ends[:, 1]] - scene.depth[ends[:, 0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        into = (scene.depth[ends[:, 0]] - np.sum(plane * a, axis=1)) / (np.sum(plane * (b - a), axis=1) - rise)
    # Right beside a corner other triangles of the same mesh may be in front; the part then ends at the corner.
    candidates += [into, np.zeros_like(into), np.ones_like(into)]
    at = np.stack(candidates, axis=1)
    away = np.stack([_distance(a, b, one, seen_at) for one in candidates], axis=1)
    away[:, 4:] -= SAME  # what meets at a corner ends there
    best = np.argmin(away, axis=1)
    rows = np.arange(len(part))
    known = away[rows, best] < APART
    kind = np.choose(np.maximum(best - 2, 0), [EDGE, CROSSING, CORNER, CORNER])
    corner = np.minimum(best, 2)
    one = np.where(best < 3, shape.faces[hiding, (corner + 1) % 3], owner)
    other = np.where(best < 3, shape.faces[hiding, (corner + 2) % 3], hiding)
    span[part[known], side[known]] = at[rows, best][known]
    found = np.stack([np.where(known, kind, CORNER), one, other], axis=1)
    stops[part, side] = found
    crossed = known & (best < 3)
    joined = np.sort(
        np.stack([shape.joined[hiding, (corner + 1) % 3], shape.joined[hiding, (corner + 2) % 3]], axis=1), axis=1
    )
    parts = _split(scene, Parts(seen.edge, span, seen.pixel, seen.sides, stops), part[crossed], joined[crossed])
    # Those that are shorter now are looked at elsewhere.
    rows = np.flatnonzero(np.any(parts.stops[:, :, 0] > HORIZONTAL, axis=1))
    again = seen.beside(parts.edge[rows], parts.pixel[rows], _nearest(scene, parts, rows))
    differ = again[:, 0] != again[:, 1]
    sides = parts.sides.copy()
    sides[rows[differ]] = again[differ]
    return replace(parts, sides=sides)


def crossing_stops(scene: Projected, seen: Seen) -> IndexArray:
    """What the lines along which triangles cut into each other end at, shape (g, 2, 3), as of :class:`Parts`."""
    stops = np.zeros((len(seen.crossing_pixel), 2, 3), np.int32)
    rows = np.arange(len(stops))
    for end in (0, 1):
        point = seen.crossing_ends[:, 2 * end : 2 * end + 2]
        off = np.abs(point - np.rint(point))
        none = np.zeros(len(rows), np.int32)
        distances: list[Any] = [off[:, 0], off[:, 1]]
        kinds = [(VERTICAL, none, none), (HORIZONTAL, none, none)]
        for side in (0, 1):
            faces = scene.topology.faces[seen.crossing_sides[:, side]]
            for k in range(3):
                line, a, b = _line(scene, faces, k)
                with np.errstate(divide="ignore", invalid="ignore"):
                    value = (np.sum(line[:, :2] * point, axis=1) + line[:, 2]) / np.hypot(line[:, 0], line[:, 1])
                distances.append(np.abs(value))
                kinds.append((EDGE, a, b))
        best = np.argmin(np.nan_to_num(np.stack(distances, axis=1), nan=np.inf), axis=1)
        for number, (kind, one, other) in enumerate(kinds):
            own = best == number
            stops[own, end] = np.stack([np.full(len(rows), kind), one, other], axis=1)[own]
    return stops


def _nearest(scene: Projected, parts: Parts, rows: Any) -> FloatArray:
    """Where parts of edges are looked at, as :func:`loi_torch.mesh.coverage.nearest_point` has it, 0 to 1 in space."""
    a, b = (scene.corners[scene.topology.ends[parts.edge[rows], k]] for k in (0, 1))
    low, high = parts.span[rows].T
    first, last = (a + one[:, None] * (b - a) for one in (low, high))
    start, end = (one[:, :2] / one[:, 2:] for one in (first, last))
    width = scene.view.width
    centre = np.stack([parts.pixel[rows] % width + 0.5, parts.pixel[rows] // width + 0.5], axis=1)
    share = nearest_share(*map(torch.from_numpy, (start, end, centre))).numpy()
    in_space = share * first[:, 2] / (last[:, 2] - share * (last[:, 2] - first[:, 2]))
    found: FloatArray = low + (high - low) * in_space
    return found


def _borders(first: FloatArray, last: FloatArray, t: FloatArray) -> IndexArray:
    """At which kind of border, or corner, points of edges lie."""
    point = first + t[:, None] * (last - first)
    point = point[:, :2] / point[:, 2:]
    off = np.abs(point - np.rint(point))
    start, end = (one[:, :2] / one[:, 2:] for one in (first, last))
    steep = np.abs(end[:, 1] - start[:, 1]) > np.abs(end[:, 0] - start[:, 0])
    # In the corner of a pixel both are borders; the one that the edge crosses at the greater angle is taken.
    upright = np.where(np.max(off, axis=1) < 1e-9, ~steep, off[:, 0] < off[:, 1])
    kind = np.where(upright, VERTICAL, HORIZONTAL)
    inside = np.min(off, axis=1) > SAME  # where nothing is known to hide the rest: an end that is not followed
    return np.where((t <= 0.0) | (t >= 1.0) | inside, CORNER, kind).astype(np.int32)


def _line(scene: Projected, faces: IndexArray, k: int) -> tuple[FloatArray, IndexArray, IndexArray]:
    """The line through the edge of triangles that is opposite to their corner `k`, and its vertices."""
    a, b = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
    return _cross(scene.corners[a], scene.corners[b]), a, b


def _meeting(a: FloatArray, b: FloatArray, line: FloatArray, *_: Any) -> FloatArray:
    """Where on edges from `a` to `b`, 0 to 1, they meet lines."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found: FloatArray = -np.sum(a * line, axis=1) / np.sum((b - a) * line, axis=1)
    return found


def _distance(a: FloatArray, b: FloatArray, t: FloatArray, other: FloatArray) -> FloatArray:
    """Pixels between two points of edges, infinite for what is no point of them."""
    with np.errstate(all="ignore"):
        p, q = (a + one[:, None] * (b - a) for one in (t, other))
        away = np.linalg.norm(p[:, :2] / p[:, 2:] - q[:, :2] / q[:, 2:], axis=1)
        inside = (t >= 0.0) & (t <= 1.0)
    return np.where(inside & np.isfinite(away), away, np.inf)


def _planes(scene: Projected, triangle: IndexArray) -> FloatArray:
    """The nearness of triangles as a x + b y + c, shape (s, 3)."""
    faces = scene.topology.faces[triangle]
    v, depth = scene.corners[faces], scene.depth[faces]
    functions = np.stack([_cross(v[:, (k + 1) % 3], v[:, (k + 2) % 3]) for k in range(3)], axis=1)
    planes: FloatArray = (
        np.sum(functions * depth[..., None], axis=1) / np.sum(v[:, 0] * functions[:, 0], axis=1)[:, None]
    )
    return planes


def _holds(face: IndexArray, ends: IndexArray) -> Any:
    """Whether triangles have both ends of edges, in the numbering in which seams are joined."""
    return np.any(face == ends[:, :1], axis=1) & np.any(face == ends[:, 1:], axis=1)


def _split(scene: Projected, parts: Parts, ending: Any, joined: IndexArray) -> Parts:
    """Split the edges in front of which others, the `ending` ones, disappear; those join the vertices `joined`."""
    shape = scene.topology
    corners = scene.corners[shape.ends[parts.edge]]
    lines = dict(zip(ending.tolist(), _cross(*corners[ending].swapaxes(0, 1)), strict=True))
    cuts = _cuts(parts, np.sort(shape.joined_ends[parts.edge], axis=1), ending, joined, corners, lines)
    if not cuts:
        return parts
    numbers = np.array(list(cuts))
    in_front = _holds(shape.joined[parts.sides[numbers, 0]], shape.joined_ends[parts.edge[numbers]])
    kept = np.ones(len(parts.edge), bool)
    kept[numbers] = False
    number_of, spans, sides, stops = [], [], [], []
    for (number, at), front in zip(cuts.items(), in_front, strict=True):
        at.sort()
        c, d = corners[number]
        limits = [parts.span[number, 0], *(t for t, _ in at), parts.span[number, 1]]
        crossed = [(EDGE, *shape.ends[parts.edge[e]]) for _, e in at]
        kinds = [parts.stops[number, 0], *crossed, parts.stops[number, 1]]
        for k in range(len(limits) - 1):
            e = at[min(k, len(at) - 1)][1]
            on_left = lines[e] @ (c + 0.5 * (limits[k] + limits[k + 1]) * (d - c)) > 0.0
            pair = parts.sides[number].copy()
            pair[1 if front else 0] = parts.sides[e, 0 if on_left else 1]
            number_of.append(number)
            spans.append(limits[k : k + 2])
            sides.append(pair)
            stops.append(kinds[k : k + 2])
    return Parts(
        np.append(parts.edge[kept], parts.edge[number_of]),
        np.concatenate([parts.span[kept], np.array(spans)]),
        np.append(parts.pixel[kept], parts.pixel[number_of]),
        np.concatenate([parts.sides[kept], np.array(sides, np.int32)]),
        np.concatenate([parts.stops[kept], np.array(stops, np.int32)]),
    )


def _cuts(
    parts: Parts, own: IndexArray, ending: Any, joined: IndexArray, corners: FloatArray, lines: dict[int, FloatArray]
) -> dict[int, list[tuple[float, int]]]:
    """Of parts that are to be split, where, and which part ends there."""
    wanted: dict[tuple[int, int, int], list[int]] = {}
    for e, pixel, (a, b) in zip(ending.tolist(), parts.pixel[ending].tolist(), joined.tolist(), strict=True):
        wanted.setdefault((pixel, a, b), []).append(e)
    near = np.flatnonzero(np.isin(parts.pixel, parts.pixel[ending]))
    cuts: dict[int, list[tuple[float, int]]] = {}
    for number, pixel, (a, b) in zip(near.tolist(), parts.pixel[near].tolist(), own[near].tolist(), strict=True):
        for e in wanted.get((pixel, a, b), ()):
            c, d = corners[number]
            slope = float(lines[e] @ (d - c))
            t = -float(lines[e] @ c) / slope if slope != 0.0 else np.nan
            if parts.span[number, 0] < t < parts.span[number, 1]:
                cuts.setdefault(number, []).append((t, e))
    return cuts


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of vectors, shape (n, 3); NumPy's own takes longer to find out what it is given."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )

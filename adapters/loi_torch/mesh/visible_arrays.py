"""What is visible where, by operations of torch on whole arrays: the steps of `loops`, where Numba is not.

Several times slower on a processor. Pairs of triangles and pixels are looked at in batches, so that memory is bounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor

from loi_torch.mesh.coverage import ENDS
from loi_torch.mesh.projected import FloatArray, IndexArray, Projected, Seen
from loi_torch.mesh.tolerances import ASIDE, EDGE_ON, HALVINGS, MARGIN, PAIRED, SAME_DEPTH, SAME_PLACE

__all__ = ["look"]

BATCH: Final = 2**22  # pairs that are looked at together


@dataclass(frozen=True)
class Triangles:
    """Of the triangles that are drawn, and then of all: see :class:`loi_torch.mesh.loops.triangles.Triangles`."""

    drawn: Tensor  # (m,) bool
    edges: Tensor  # (m, 3, 3)
    nearness: Tensor  # (m, 3)
    facing: Tensor  # (m,)
    box: Tensor  # (m, 4)
    most: float


@dataclass(frozen=True)
class Lists:
    """Triangles by pixel: those of pixel p are ``triangle[first[p]:first[p + 1]]``."""

    first: Tensor
    triangle: Tensor


def look(scene: Projected) -> Seen:
    """What is seen of a projected scene."""
    shape, view = scene.topology, scene.view
    corners, depth = torch.as_tensor(scene.corners), torch.as_tensor(scene.depth)
    faces, joined, ends, joined_ends, between = (
        torch.as_tensor(one, dtype=torch.int64)
        for one in (shape.faces, shape.joined, shape.ends, shape.joined_ends, shape.between)
    )
    size = view.height, view.width
    triangles = _prepare(corners, depth, faces, size, view.near, view.most)
    found = _depth_buffer(triangles, size)
    active = _active(triangles, between, torch.as_tensor(shape.always))
    edge, pixel, span, screen = _walk(corners, ends[active], size, view.near)
    edge = active[edge]
    piece = torch.as_tensor(shape.piece, dtype=torch.int64)
    crossed = _crossed(found, piece, size) if shape.several else torch.zeros(len(found), dtype=torch.bool)
    wanted = crossed.clone()
    wanted[pixel] = True
    lists = _list(triangles, wanted, size)
    parts = _Parts(triangles, lists, joined, joined_ends[edge], pixel, screen)
    shown, on_screen, sides, beyond = parts.visible(span, size[1])
    edge, pixel = edge[shown], pixel[shown]
    crossings = _crossings(triangles, lists, piece, torch.nonzero(crossed)[:, 0], size[1])
    in_space = parts.in_space(on_screen, shown)

    def beside(edge: IndexArray, pixel: IndexArray, at: FloatArray) -> IndexArray:
        a, b = (corners[ends[torch.as_tensor(edge, dtype=torch.int64), k]] for k in (0, 1))
        point = a + torch.as_tensor(at)[:, None] * (b - a)
        x, y = (point[:, :2] / point[:, 2:]).unbind(dim=1)
        along = b[:, :2] * a[:, 2:] - a[:, :2] * b[:, 2:]
        nx, ny = (ASIDE * along / torch.linalg.vector_norm(along, dim=1, keepdim=True)).unbind(dim=1)
        where = torch.as_tensor(pixel, dtype=torch.int64)
        left = _nearest(triangles, lists, where, x - ny, y + nx)
        right = _nearest(triangles, lists, where, x + ny, y - nx)
        both: IndexArray = torch.stack([left, right], dim=1).numpy().astype("int32")
        return both

    columns: list[Any] = [
        one.numpy().astype("int32" if one.dtype == torch.int64 else "float64")
        for one in (found, edge, in_space, pixel, sides, beyond, *crossings)
    ]
    columns.append(beside)
    return Seen(*columns)


def _prepare(
    corners: Tensor, depth: Tensor, faces: Tensor, size: tuple[int, int], near: float, most: float
) -> Triangles:
    v = corners[faces]
    edges = torch.stack([torch.linalg.cross(v[:, (k + 1) % 3], v[:, (k + 2) % 3]) for k in range(3)], dim=1)
    det = (v[:, 0] * edges[:, 0]).sum(dim=1)
    edges = torch.where(det[:, None, None] < 0.0, -edges, edges)
    nearness = (depth[faces][..., None] * edges).sum(dim=1) / det.abs()[:, None]
    w, following = v[..., 2], v.roll(-1, dims=1)
    before = w >= near
    sides = v[..., :2] / torch.where(before, w, torch.ones_like(w))[..., None]
    largest = ((sides - sides.roll(-1, dims=1)) ** 2).sum(dim=2).amax(dim=1) * w.prod(dim=1)
    real = det.abs() > EDGE_ON * torch.where(before.all(dim=1), largest, torch.zeros_like(largest))
    xy = v[..., :2] / torch.where(before, w, torch.ones_like(w))[..., None]
    cut = before != before.roll(-1, dims=1)
    t = (near - w) / torch.where(cut, following[..., 2] - w, torch.ones_like(w))
    at_cut = (v[..., :2] + t[..., None] * (following[..., :2] - v[..., :2])) / near
    points = torch.cat([xy, at_cut], dim=1)
    known = torch.cat([before, cut], dim=1)[..., None]
    low = torch.where(known, points, torch.full_like(points, torch.inf)).amin(dim=1) - MARGIN
    high = torch.where(known, points, torch.full_like(points, -torch.inf)).amax(dim=1) + MARGIN
    height, width = size
    drawn = real & before.any(dim=1) & (high > 0.0).all(dim=1) & (low[:, 0] < width) & (low[:, 1] < height)
    box = torch.stack(
        [
            low[:, 0].clamp(0.0, width),
            high[:, 0].clamp(0.0, width - 0.5),
            low[:, 1].clamp(0.0, height),
            high[:, 1].clamp(0.0, height - 0.5),
        ],
        dim=1,
    ).to(torch.int64)
    facing = torch.where(real & before.any(dim=1), torch.sign(det), torch.zeros_like(det))
    return Triangles(drawn, edges, nearness, facing, box, most)


def _spread(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For as many items as `counts` has in sum: which count each belongs to, and its place there."""
    owner = torch.repeat_interleave(torch.arange(len(counts)), counts)
    first = torch.cumsum(counts, 0) - counts
    return owner, torch.arange(len(owner)) - first[owner]


def _pairs(triangles: Triangles, width: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Every drawn triangle with every pixel of its box, in batches: numbers of triangles, and of pixels."""
    drawn = torch.nonzero(triangles.drawn)[:, 0]
    box = triangles.box[drawn]
    across = box[:, 1] - box[:, 0] + 1
    area = across * (box[:, 3] - box[:, 2] + 1)
    batch = torch.div(torch.cumsum(area, 0) - area, BATCH, rounding_mode="floor")
    for number in torch.unique(batch).tolist():
        own = torch.nonzero(batch == number)[:, 0]
        owner, place = _spread(area[own])
        owner = own[owner]
        row = torch.div(place, across[owner], rounding_mode="floor")
        column = place - row * across[owner]
        yield drawn[owner], (box[owner, 2] + row) * width + box[owner, 0] + column


def _functions(edges: Tensor, x: Tensor, y: Tensor) -> Tensor:
    return edges[..., 0] * x[:, None] + edges[..., 1] * y[:, None] + edges[..., 2]


def _near(triangles: Triangles, triangle: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The nearness of triangles' planes at points."""
    plane = triangles.nearness[triangle]
    return plane[:, 0] * x + plane[:, 1] * y + plane[:, 2]


def _hits(triangles: Triangles, triangle: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Which pairs of a triangle and a point meet, and the nearness there."""
    near = _near(triangles, triangle, x, y)
    inside = (_functions(triangles.edges[triangle], x, y) >= 0.0).all(dim=1) & (near <= triangles.most)
    return torch.nonzero(inside)[:, 0], near


def _first_nearest(place: Tensor, near: Tensor, triangle: Tensor, count: int) -> Tensor:
    """Of each place the triangle that is nearest, the first of equally near ones, or -1."""
    best = torch.full((count,), -torch.inf, dtype=torch.float64).scatter_reduce(0, place, near, "amax")
    top = near == best[place]
    none = torch.iinfo(torch.int64).max
    found = torch.full((count,), none).scatter_reduce(0, place[top], triangle[top], "amin")
    return torch.where(found == none, -1, found)


def _depth_buffer(triangles: Triangles, size: tuple[int, int]) -> Tensor:
    height, width = size
    places, nears, numbers = [], [], []
    for triangle, pixel in _pairs(triangles, width):
        hit, near = _hits(
            triangles, triangle, pixel % width + 0.5, torch.div(pixel, width, rounding_mode="floor") + 0.5
        )
        # Of each batch only what is nearest in it goes on.
        best = _first_nearest(pixel[hit], near[hit], triangle[hit], height * width)
        kept = torch.nonzero(best >= 0)[:, 0]
        places.append(kept)
        numbers.append(best[kept])
        x, y = kept % width + 0.5, torch.div(kept, width, rounding_mode="floor") + 0.5
        nears.append(_near(triangles, best[kept], x, y))
    if not places:
        return torch.full((height * width,), -1)
    return _first_nearest(torch.cat(places), torch.cat(nears), torch.cat(numbers), height * width)


def _active(triangles: Triangles, between: Tensor, always: Tensor) -> Tensor:
    one, other = between.unbind(dim=1)
    pair = other >= 0
    shown = triangles.drawn[one] | (pair & triangles.drawn[other])
    alike = pair & (triangles.facing[one] * triangles.facing[other] > 0)
    return torch.nonzero(shown & (always | ~alike))[:, 0]


@dataclass(frozen=True)
class _Screen:
    """Edges on the screen: their ends, w at these, and what part of the edge they bound."""

    first: Tensor
    last: Tensor
    w: Tensor
    share: Tensor

    def at(self, s: Tensor) -> tuple[Tensor, Tensor]:
        point = self.first + s[:, None] * (self.last - self.first)
        return point[:, 0], point[:, 1]

    def of(self, rows: Tensor) -> _Screen:
        return _Screen(self.first[rows], self.last[rows], self.w[rows], self.share[rows])


def _walk(corners: Tensor, ends: Tensor, size: tuple[int, int], near: float) -> tuple[Tensor, Tensor, Tensor, _Screen]:
    """Edges cut where they leave pixels: numbers of edges and pixels, where each part begins and ends, and the edge."""
    a, b = corners[ends[:, 0]], corners[ends[:, 1]]
    wa, wb = a[:, 2], b[:, 2]
    kept = (wa >= near) | (wb >= near)
    cut = (near - wa) / torch.where(wa == wb, torch.ones_like(wa), wb - wa)
    start = torch.where(wa < near, cut, torch.zeros_like(cut))
    end = torch.where(wb < near, cut, torch.ones_like(cut))
    p, q = (a + one[:, None] * (b - a) for one in (start, end))
    w = torch.stack([p[:, 2], q[:, 2]], dim=1)
    w = torch.where(kept[:, None], w, torch.ones_like(w))
    screen = _Screen(p[:, :2] / w[:, :1], q[:, :2] / w[:, 1:], w, torch.stack([start, end], dim=1))
    along = screen.last - screen.first
    low, high = torch.zeros_like(wa), torch.ones_like(wa)
    for axis, limit in ((0, size[1]), (1, size[0])):
        at, by = screen.first[:, axis], along[:, axis]
        level = by == 0.0
        kept = kept & ~(level & ((at < 0.0) | (at >= limit)))
        by = torch.where(level, torch.ones_like(by), by)
        s0, s1 = -at / by, (limit - at) / by
        low = torch.where(level, low, torch.maximum(low, torch.minimum(s0, s1)))
        high = torch.where(level, high, torch.minimum(high, torch.maximum(s0, s1)))
    number = torch.nonzero(kept & (high > low))[:, 0]
    screen, low, high = screen.of(number), low[number], high[number]
    cuts_edge, cuts = [torch.arange(len(number)).repeat(2)], [torch.cat([low, high])]
    for axis in (0, 1):
        at, by = screen.first[:, axis], screen.last[:, axis] - screen.first[:, axis]
        begin, stop = at + low * by, at + high * by
        first, last = torch.minimum(begin, stop).ceil(), torch.maximum(begin, stop).floor()
        owner, place = _spread((last - first + 1.0).clamp(min=0.0).to(torch.int64))
        owner, place = owner[by[owner] != 0.0], place[by[owner] != 0.0]
        cuts_edge.append(owner)
        cuts.append((first[owner] + place - at[owner]) / by[owner])
    at, owner = torch.cat(cuts), torch.cat(cuts_edge)
    at = torch.minimum(torch.maximum(at, low[owner]), high[owner])
    order = torch.argsort(at)
    order = order[torch.argsort(owner[order], stable=True)]
    at, owner = at[order], owner[order]
    real = torch.nonzero((owner[1:] == owner[:-1]) & (at[1:] > at[:-1]))[:, 0]
    span, owner = torch.stack([at[real], at[real + 1]], dim=1), owner[real]
    screen = screen.of(owner)
    x, y = screen.at(span.mean(dim=1))
    column, row = x.floor().to(torch.int64), y.floor().to(torch.int64)
    inside = torch.nonzero((column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0]))[:, 0]
    pixel = (row * size[1] + column)[inside]
    return number[owner[inside]], pixel, span[inside], screen.of(inside)


def _list(triangles: Triangles, wanted: Tensor, size: tuple[int, int]) -> Lists:
    pixels, numbers = [], []
    half = 0.5 + MARGIN
    for triangle, pixel in _pairs(triangles, size[1]):
        own = wanted[pixel]
        triangle, pixel = triangle[own], pixel[own]
        edges = triangles.edges[triangle]
        x, y = pixel % size[1] + 0.5, torch.div(pixel, size[1], rounding_mode="floor") + 0.5
        reach = _functions(edges, x, y) + half * (edges[..., 0].abs() + edges[..., 1].abs())
        touching = (reach >= 0.0).all(dim=1)
        pixels.append(pixel[touching])
        numbers.append(triangle[touching])
    total = size[0] * size[1]
    if not pixels:
        return Lists(torch.zeros(total + 1, dtype=torch.int64), torch.zeros(0, dtype=torch.int64))
    pixel, triangle = torch.cat(pixels), torch.cat(numbers)
    order = torch.argsort(pixel, stable=True)
    first = torch.cat([torch.zeros(1, dtype=torch.int64), torch.cumsum(torch.bincount(pixel, minlength=total), 0)])
    return Lists(first, triangle[order])


def _nearest(triangles: Triangles, lists: Lists, pixel: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The triangle that is nearest at points of pixels, or -1."""
    first = lists.first[pixel]
    count = lists.first[pixel + 1] - first
    if int(count.sum()) > BATCH and len(pixel) > 1:
        halves = zip(pixel.chunk(2), x.chunk(2), y.chunk(2), strict=True)
        return torch.cat([_nearest(triangles, lists, *half) for half in halves])
    owner, place = _spread(count)
    triangle = lists.triangle[first[owner] + place]
    hit, near = _hits(triangles, triangle, x[owner], y[owner])
    return _first_nearest(owner[hit], near[hit], triangle[hit], len(pixel))


def _ends_at(triangles: Triangles, triangle: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Whether triangles have an edge at points."""
    edges = triangles.edges[triangle]
    length = torch.hypot(edges[..., 0], edges[..., 1])
    return (_functions(edges, x, y).abs() <= SAME_PLACE * length).any(dim=1)


class _Parts:
    """Parts of edges within pixels, of which some show."""

    def __init__(
        self, triangles: Triangles, lists: Lists, joined: Tensor, ends: Tensor, pixel: Tensor, screen: _Screen
    ) -> None:
        self._triangles, self._lists, self._joined = triangles, lists, joined
        self._ends, self._pixel, self._screen = ends, pixel, screen
        along = screen.last - screen.first
        along = along / torch.linalg.vector_norm(along, dim=1, keepdim=True)
        self._normal = torch.stack([-along[:, 1], along[:, 0]], dim=1)

    def _sides(self, rows: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        """Whether the edges show at points of them, and the triangles on their left and right, (r, 2)."""
        x, y = self._screen.of(rows).at(s)
        nx, ny = (ASIDE * self._normal[rows]).unbind(dim=1)
        left = _nearest(self._triangles, self._lists, self._pixel[rows], x + nx, y + ny)
        right = _nearest(self._triangles, self._lists, self._pixel[rows], x - nx, y - ny)
        sides = torch.stack([left, right], dim=1)
        both = (left >= 0) & (right >= 0)
        near, far = (_near(self._triangles, one.clamp(min=0), x, y) for one in (left, right))
        touching = both & ((near - far).abs() <= SAME_DEPTH * torch.maximum(near.abs(), far.abs()))
        front = self._has(self._front(rows, s, sides), rows)
        of_left, of_right = self._has(left, rows), self._has(right, rows)
        own, other = torch.where(of_left, left, right), torch.where(of_left, right, left)
        alone = (own < other) | ~_ends_at(self._triangles, other.clamp(min=0), x, y)
        touch = torch.where(of_left == of_right, of_left, alone)
        return torch.where(touching, touch, front) & (left != right), sides

    def _has(self, triangle: Tensor, rows: Tensor) -> Tensor:
        """Whether triangles have both ends of the edges."""
        face, ends = self._joined[triangle.clamp(min=0)], self._ends[rows]
        return (triangle >= 0) & (face == ends[:, :1]).any(dim=1) & (face == ends[:, 1:]).any(dim=1)

    def _front(self, rows: Tensor, s: Tensor, sides: Tensor) -> Tensor:
        """Which of the triangles on the two sides is in front."""
        x, y = self._screen.of(rows).at(s)
        left, right = sides.unbind(dim=1)
        near, far = (_near(self._triangles, one.clamp(min=0), x, y) for one in (left, right))
        front = torch.where(near > far, left, right)
        return torch.where((left < 0) | (right < 0), torch.maximum(left, right), front)

    def visible(self, span: Tensor, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The parts that show: their rows, where they begin and end, (r, 2), their sides, and what hides the rest."""
        every = torch.arange(len(span))
        x, y = self._pixel % width + 0.5, torch.div(self._pixel, width, rounding_mode="floor") + 0.5
        along, aside = self._screen.last - self._screen.first, torch.stack([x, y], dim=1) - self._screen.first
        ends = ENDS * (span[:, 1] - span[:, 0])
        nearest = (aside * along).sum(dim=1) / (along * along).sum(dim=1)
        middle = torch.minimum(torch.maximum(nearest, span[:, 0] + ends), span[:, 1] - ends)
        lit, sides = self._sides(every, middle)
        whole, hidden = span.clone(), torch.full_like(sides, -1)
        rows, spans, both, beyond = [], [], [], []
        for side in (0, 1):
            limit = span[:, side]
            bright, other = self._sides(every, limit + 1e-4 * (middle - limit))
            own = torch.nonzero(bright != lit)[:, 0]
            light = torch.where(lit[own], middle[own], limit[own])
            dark = torch.where(lit[own], limit[own], middle[own])
            for _ in range(HALVINGS):
                between = 0.5 * (light + dark)
                shows = self._sides(own, between)[0]
                light, dark = torch.where(shows, between, light), torch.where(shows, dark, between)
            border, hider = 0.5 * (light + dark), self._front(own, dark, self._sides(own, dark)[1])
            shone = lit[own]
            whole[own[shone], side], hidden[own[shone], side] = border[shone], hider[shone]
            end, at = own[~shone], torch.full((int((~shone).sum()), 2), -1)
            at[:, 1 - side] = hider[~shone]
            pair = [limit[end], border[~shone]]
            rows.append(end)
            spans.append(torch.stack(pair if side == 0 else pair[::-1], dim=1))
            both.append(other[end])
            beyond.append(at)
        shown = torch.nonzero(lit)[:, 0]
        return (
            torch.cat([*rows, shown]),
            torch.cat([*spans, whole[shown]]),
            torch.cat([*both, sides[shown]]),
            torch.cat([*beyond, hidden[shown]]),
        )

    def in_space(self, s: Tensor, rows: Tensor) -> Tensor:
        """From shares of edges on the screen, (r, 2), to those in space."""
        one = self._screen.of(rows)
        (wa, wb), (start, end) = one.w.T[..., None], one.share.T[..., None]
        shares: Tensor = start + (end - start) * (s * wa / (wb - s * (wb - wa)))
        return shares


def _crossed(found: Tensor, piece: Tensor, size: tuple[int, int]) -> Tensor:
    """The pixels next to two neighbours that show different pieces."""
    height, width = size
    shown = torch.where(found >= 0, piece[found.clamp(min=0)] if len(piece) else found, -1).reshape(height, width)
    wanted = torch.zeros((height + 2, width + 2), dtype=torch.bool)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = shown[: height - down, max(-right, 0) : width - max(right, 0)]
        there = shown[down:, max(right, 0) : width - max(-right, 0)]
        for row, column in torch.nonzero((here != there) & (here >= 0) & (there >= 0)).tolist():
            one, other = column + max(-right, 0), column + max(right, 0)
            wanted[row : row + down + 3, min(one, other) : max(one, other) + 3] = True
    return wanted[1:-1, 1:-1].reshape(-1)


def _crossings(
    triangles: Triangles, lists: Lists, piece: Tensor, pixels: Tensor, width: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Where triangles of two pieces cut into each other, and it shows: pixels, sides, ends."""
    first, listed = _nearest_few(triangles, lists, pixels, width)
    count = (lists.first[pixels + 1] - lists.first[pixels]).clamp(max=PAIRED)
    owner, place = _spread(count * count)
    i, j = torch.div(place, count[owner], rounding_mode="floor"), place % count[owner].clamp(min=1)
    below = i < j
    owner, i, j = owner[below], i[below], j[below]
    t, u = listed[first[owner] + i], listed[first[owner] + j]
    apart = piece[t] != piece[u]
    pixel, t, u = pixels[owner[apart]], t[apart], u[apart]
    plane = triangles.nearness[t] - triangles.nearness[u]
    length = torch.hypot(plane[:, 0], plane[:, 1])
    x, y = pixel % width + 0.5, torch.div(pixel, width, rounding_mode="floor") + 0.5
    away = (plane[:, 0] * x + plane[:, 1] * y + plane[:, 2]) / length
    kept = (length > 0.0) & (away.abs() <= 0.75)
    pixel, t, u, plane, length, away, x, y = (one[kept] for one in (pixel, t, u, plane, length, away, x, y))
    nx, ny = plane[:, 0] / length, plane[:, 1] / length
    px, py, dx, dy = x - away * nx, y - away * ny, ny, -nx
    low, high = torch.full_like(x, -2.0), torch.full_like(x, 2.0)
    for at, by in [
        *(pair for p, d, m in ((px, dx, x), (py, dy, y)) for pair in ((p - m + 0.5, d), (m + 0.5 - p, -d))),
        *(
            (_functions(e[:, k, None], px, py)[:, 0], e[:, k, 0] * dx + e[:, k, 1] * dy)
            for e in _both(triangles, t, u)
            for k in range(3)
        ),
    ]:
        where = -at / torch.where(by == 0.0, torch.ones_like(by), by)
        low = torch.where(by > 0.0, torch.maximum(low, where), low)
        high = torch.where(by < 0.0, torch.minimum(high, where), high)
        high = torch.where((by == 0.0) & (at < 0.0), torch.full_like(high, -3.0), high)
    kept = high - low > 1e-9
    pixel, t, u, px, py, dx, dy, nx, ny, low, high = (
        one[kept] for one in (pixel, t, u, px, py, dx, dy, nx, ny, low, high)
    )
    ends_of = ENDS * (high - low)
    nearest = torch.minimum((low + ends_of).clamp(min=0.0), high - ends_of)
    qx, qy = px + nearest * dx, py + nearest * dy
    met = _ends_at(triangles, t, qx, qy) | _ends_at(triangles, u, qx, qy)
    shown = (
        ~met
        & (_nearest(triangles, lists, pixel, qx + ASIDE * nx, qy + ASIDE * ny) == t)
        & (_nearest(triangles, lists, pixel, qx - ASIDE * nx, qy - ASIDE * ny) == u)
    )
    ends = torch.stack([px + low * dx, py + low * dy, px + high * dx, py + high * dy], dim=1)
    return pixel[shown], torch.stack([t, u], dim=1)[shown], ends[shown]


def _nearest_few(triangles: Triangles, lists: Lists, pixels: Tensor, width: int) -> tuple[Tensor, Tensor]:
    """Of each pixel where its list begins in another table, in which those come first that may be nearest."""
    owner, place = _spread(lists.first[pixels + 1] - lists.first[pixels])
    triangle = lists.triangle[lists.first[pixels][owner] + place]
    plane, pixel = triangles.nearness[triangle], pixels[owner]
    x, y = pixel % width + 0.5, torch.div(pixel, width, rounding_mode="floor") + 0.5
    most = plane[:, 0] * x + plane[:, 1] * y + plane[:, 2] + (0.5 + MARGIN) * plane[:, :2].abs().sum(dim=1)
    order = torch.argsort(-most, stable=True)
    order = order[torch.argsort(owner[order], stable=True)]
    count = torch.bincount(owner, minlength=len(pixels))
    return torch.cumsum(count, 0) - count, triangle[order]


def _both(triangles: Triangles, t: Tensor, u: Tensor) -> tuple[Any, Any]:
    return triangles.edges[t], triangles.edges[u]

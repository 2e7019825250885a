"""The image of meshes, which torch can differentiate.

Which triangle is seen where is found without gradients (:mod:`loi_torch.mesh.visibility`). Colours are interpolated at
the centres of pixels, and on both sides of each edge that shows, with gradients by vertices, cameras, colours, textures
and lights. The areas of :mod:`loi_torch.mesh.coverage` then mix them, and have the gradient of what moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.renderers.checks import check_size
from loi_core.support.arrays import to_numpy
from loi_core.support.wording import shown
from loi_torch.mesh import visibility
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.coverage import hidden_area, nearest_point
from loi_torch.mesh.interpolation import Samples, corner_rows, interpolate, weights
from loi_torch.mesh.junctions import CROSSING, EDGE, HORIZONTAL, VERTICAL, Parts, crossing_stops, settled
from loi_torch.mesh.lighting import Environment, Light, reflected
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.projected import Projected, Seen, View
from loi_torch.mesh.tensors import colours_behind, unit
from loi_torch.mesh.textures import Pyramid
from loi_torch.mesh.topology import join

__all__ = ["Frame", "draw", "draw_places", "shade"]

ASIDE: Final = 1e-6  # pixels by which a centre that lies on an edge is moved
STEEP: Final = 1e-6  # sine of the least angle between two lines at which the point where they meet is followed


def draw(
    meshes: Sequence[Mesh],
    camera: Camera,
    height: int,
    width: int,
    *,
    lights: Sequence[Light] = (),
    environment: Environment | None = None,
    background: Any = 0.0,
) -> Tensor:
    """The image of meshes.

    Parameters
    ----------
    meshes : sequence of Mesh
        What is seen; they may cut into each other.
    camera : Camera
    height, width : int
        Of the image, in pixels.
    lights : sequence of Light
        Without any, and without an environment, surfaces show their colours as they are.
    environment : Environment, optional
        What mirrors show.
    background : float, array of shape (3,) or (height, width, 3), or Environment
        Linear RGB behind all meshes.

    Returns
    -------
    Tensor, shape (height, width, 3), float64
        Linear RGB, differentiable.

    Raises
    ------
    ParameterError
        If an argument is of another kind or shape.
    """
    if isinstance(lights, Light):
        msg = "`lights` must be a list of Light, got one"
        raise ParameterError(msg)
    frame = Frame(meshes, camera, height, width)
    behind = frame.behind(background)
    covered = np.flatnonzero(frame.seen.found >= 0)
    jumps = frame.jumps()
    # A side that shows the surface of the centre has the colour of the centre; others are looked at beside the edge.
    rows = [np.flatnonzero((side >= 0) & ~known) for side, known in zip(jumps.sides, jumps.known, strict=True)]
    triangle = [side[own] for side, own in zip(jumps.sides, rows, strict=True)]
    beside = [jumps.beside.index_select(0, frame.tensor(own)) for own in rows]
    samples = frame.samples(
        np.concatenate([frame.seen.found[covered], *triangle]), torch.cat([frame.centres(covered), *beside])
    )
    inner, *colours = torch.split(shade(frame, samples, lights, environment), [len(covered), *map(len, rows)])
    image = behind.index_copy(0, frame.tensor(covered), inner)
    if len(jumps.pixels):
        at = frame.tensor(jumps.pixels)
        base, centre = behind.index_select(0, at), image.index_select(0, at)
        left, right = (
            torch.where(torch.as_tensor(known, device=frame.device)[:, None], centre, base).index_copy(
                0, frame.tensor(own), colour
            )
            for known, own, colour in zip(jumps.known, rows, colours, strict=True)
        )
        image = image.index_add(0, at, jumps.areas[:, None] * (right - left))
    return frame.attached(image).reshape(height, width, 3)


def draw_places(
    meshes: Sequence[Mesh],
    camera: Camera,
    height: int,
    width: int,
    *,
    lights: Sequence[Light] = (),
    environment: Environment | None = None,
    background: Any = 0.0,
) -> Tensor:
    """Colours and places, that follow the surface: what RGBXY compares (Xing et al. 2022).

    Arguments as those of :func:`draw`. Outlines are jagged: each pixel shows what is at its centre.

    Returns
    -------
    Tensor, shape (height, width, 5), float64
        Linear RGB, and x and y, 0 to 1 over the image. A covered pixel's five numbers have the gradients of the point
        of the surface that it shows, as it moves; the places of others are constant.
    """
    frame = Frame(meshes, camera, height, width)
    covered = np.flatnonzero(frame.seen.found >= 0)
    centres = frame.centres(np.arange(height * width))
    size = torch.tensor([width, height], dtype=torch.float64, device=frame.device)
    result = torch.cat([frame.behind(background), centres / size], dim=1)
    if len(covered):
        at = frame.tensor(covered)
        samples = frame.samples(frame.seen.found[covered], centres.index_select(0, at))
        screen = corner_rows(frame.corners, samples.corners)
        shares = weights(screen, samples.points)[0].detach()
        colours = shade(frame, samples, lights, environment, fixed=True)
        places = interpolate(frame.world, samples.corners, shares)
        moved = camera.project(places, height, width)[0]
        result = result.index_copy(0, at, torch.cat([colours, moved[:, :2] / moved[:, 2:] / size], dim=1))
    return frame.attached(result).reshape(height, width, 5)


@dataclass(frozen=True)
class Jumps:
    """Where colours jump within pixels.

    Attributes
    ----------
    pixels : array of int, shape (f,)
    sides : arrays of int, shape (f,)
        The triangles on the left and right, -1 for none.
    known : arrays of bool, shape (f,)
        Whether the left, or the right, is on the centre's side and of the surface that is seen there.
    beside : Tensor, shape (f, 2)
        Where the two sides are looked at, in pixels.
    areas : Tensor, shape (f,)
        See :func:`loi_torch.mesh.coverage.hidden_area`.
    """

    pixels: Any
    sides: tuple[Any, Any]
    known: tuple[Any, Any]
    beside: Tensor
    areas: Tensor


class Frame:
    """Meshes on the screen.

    Parameters
    ----------
    meshes, camera, height, width
        As of :func:`draw`.
    look : callable, optional
        Finds what is seen; :func:`loi_torch.mesh.visibility.look` by default.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        camera: Camera,
        height: int,
        width: int,
        look: Callable[[Projected], Seen] | None = None,
    ) -> None:
        if isinstance(meshes, Mesh) or not all(isinstance(one, Mesh) for one in meshes):
            msg = f"`meshes` must be a list of Mesh, got {shown(meshes)}"
            raise ParameterError(msg)
        if not isinstance(camera, Camera):
            msg = f"`camera` must be a Camera, got {shown(camera)}"
            raise ParameterError(msg)
        height, width = check_size("height", height), check_size("width", width)
        self.meshes, self.camera = meshes, camera
        self.size = height, width
        self.world = torch.cat([one.vertices for one in meshes]) if meshes else torch.zeros((0, 3), dtype=torch.float64)
        self.device = self.world.device
        counts = [len(one.vertices) for one in meshes]
        self.first_vertex = np.append(0, np.cumsum(counts)).astype(np.int64)
        self.first_triangle = np.append(0, np.cumsum([len(one.faces) for one in meshes])).astype(np.int64)
        self.topology = join([one.topology for one in meshes], counts)
        self.corners, self.depth = camera.project(self.world, height, width)
        self.view: View = camera.view(height, width)
        self.projected = Projected(
            self.topology, self.view, to_numpy(self.corners.detach()), to_numpy(self.depth.detach())
        )
        self.seen: Seen = (look or visibility.look)(self.projected)

    def tensor(self, array: Any) -> Tensor:
        """Indices for torch."""
        return torch.as_tensor(array, dtype=torch.int64, device=self.device)

    def centres(self, pixels: Any) -> Tensor:
        """Of pixels, shape (s, 2)."""
        width = self.size[1]
        return torch.as_tensor(np.stack([pixels % width + 0.5, pixels // width + 0.5], axis=1), device=self.device)

    def samples(self, triangle: Any, points: Tensor) -> Samples:
        """Points of triangles."""
        return Samples(
            self.tensor(self.topology.faces[triangle]),
            self.tensor(np.searchsorted(self.first_triangle, triangle, side="right") - 1),
            points,
            self.tensor(triangle),
        )

    def behind(self, background: Any) -> Tensor:
        """The background of every pixel, shape (H * W, 3)."""
        height, width = self.size
        if isinstance(background, Environment):
            centres = self.centres(np.arange(height * width))
            directions = self.camera.directions(centres, height, width)
            return background.radiance(directions, self.pixel_angle(height * width))
        colours = colours_behind(background, height, width).to(self.device)
        return colours.reshape(-1, 3) if colours.ndim == 3 else colours.expand(height * width, 3)

    def attached(self, image: Tensor) -> Tensor:
        """An image that belongs to the graph of what is drawn, also where nothing of it is seen: its gradient is 0."""
        if image.requires_grad:
            return image
        drawn = [value for one in self.meshes for value in (one.vertices, one.colours, one.texture)]
        drawn += [self.camera.position, self.camera.target, self.camera.up, self.camera.fov, self.camera.extent]
        for value in drawn:
            if value is not None and value.requires_grad:
                image = image + 0.0 * value.sum()
        return image

    def pixel_angle(self, count: int) -> Tensor:
        """About the angle that a pixel sees, in radians, shape (count,)."""
        height = self.size[0]
        fov = 0.0 if self.camera.extent is not None else float(self.camera.fov.detach())
        return torch.full((count,), float(np.radians(fov)) / height, dtype=torch.float64, device=self.device)

    def jumps(self) -> Jumps:
        """Every part of an edge that shows, and of a line along which meshes cut into each other."""
        seen = self.seen
        parts = settled(self.projected, seen)
        first, last, turn = self._edge_ends(parts)
        if len(seen.crossing_pixel):
            crossing = self._crossing_ends()
            first, last, turn = (torch.cat(pair) for pair in zip((first, last, turn), crossing, strict=True))
        pixels = np.concatenate([parts.pixel, seen.crossing_pixel])
        left, right = np.concatenate([parts.sides, seen.crossing_sides]).T
        centres = self.centres(pixels)
        if bool((turn == 0.0).any()):
            centres, turn = self._off_edges(pixels, centres, first.detach(), last.detach(), turn)
        return Jumps(
            pixels,
            (left, right),
            self._known(pixels, left, right, to_numpy(turn)),
            nearest_point(first, last, centres),
            hidden_area(first - centres, last - centres, turn),
        )

    def _known(self, pixels: Any, left: Any, right: Any, turn: Any) -> tuple[Any, Any]:
        """See :class:`Jumps`."""
        found = self.seen.found[pixels]
        facing, sheet = self._facing(found), self._sheet(found)

        def same(side: Any, towards: float) -> Any:
            alike = (self._sheet(side) == sheet) & (self._facing(side) == facing)
            return (found >= 0) & (side >= 0) & (turn == towards) & alike

        return same(left, 1.0), same(right, -1.0)

    def _sheet(self, triangle: Any) -> Any:
        return self.topology.sheet[triangle] if len(self.topology.sheet) else triangle

    def _facing(self, triangle: Any) -> Any:
        """The sign of triangles' volume, with the eye at the tip."""
        faces = self.topology.faces
        return np.sign(np.linalg.det(self.projected.corners[faces[triangle]])) if len(faces) else triangle

    def _off_edges(
        self, pixels: Any, centres: Tensor, first: Tensor, last: Tensor, turn: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Centres that lie on edges, moved a little into the triangle that they show, and which way edges run then."""
        held = np.flatnonzero(np.isin(pixels, pixels[to_numpy(turn) == 0.0]))
        at = self.tensor(held)
        corners = corner_rows(self.corners.detach(), self.tensor(self.topology.faces[self.seen.found[pixels[held]]]))
        inwards = (corners[..., :2] / corners[..., 2:].clamp(min=self.view.near)).mean(dim=1) - centres[at]
        moved = centres[at] + ASIDE * unit(inwards)
        a, b = first[at] - moved, last[at] - moved
        around = torch.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        return centres.index_copy(0, at, moved), turn.index_copy(0, at, around)

    def _edge_ends(self, parts: Parts) -> tuple[Tensor, Tensor, Tensor]:
        """Both ends of parts of edges, in pixels, as they move; and which way they run around centres."""
        ends = self.topology.ends[parts.edge]
        a, b = (self.corners.index_select(0, self.tensor(ends[:, k])) for k in (0, 1))
        span = torch.as_tensor(parts.span, device=self.device)
        normal = self._edge_line(ends)[:, :2].detach()
        points = []
        for k in (0, 1):
            on_edge = a + span[:, k, None] * (b - a)
            points.append(self._stopped(on_edge[:, :2] / on_edge[:, 2:], normal, parts.stops[:, k]))
        p, q = a.detach(), b.detach()
        x, y = self.centres(parts.pixel).unbind(dim=1)
        # The same arithmetic as the edge functions', so that both agree on which side a centre lies.
        across = (
            (p[:, 1] * q[:, 2] - p[:, 2] * q[:, 1]) * x
            + (p[:, 2] * q[:, 0] - p[:, 0] * q[:, 2]) * y
            + (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
        )
        return points[0], points[1], torch.sign(across)

    def _crossing_ends(self) -> tuple[Tensor, Tensor, Tensor]:
        """The same for parts of lines along which two triangles cut into each other."""
        seen = self.seen
        stops = crossing_stops(self.projected, seen)
        line = self._crossing_line(seen.crossing_sides)
        normal = line[:, :2].detach()
        points = []
        for k in (0, 1):
            fixed = torch.as_tensor(seen.crossing_ends[:, 2 * k : 2 * k + 2], device=self.device)
            points.append(self._stopped(fixed + normal * _moved(line, fixed)[:, None], normal, stops[:, k]))
        return points[0], points[1], torch.sign(_value(line.detach(), self.centres(seen.crossing_pixel)))

    def _stopped(self, point: Tensor, normal: Tensor, stops: Any) -> Tensor:
        """Points of lines, which move along with them, held by what the lines end at.

        Parameters
        ----------
        point : Tensor, shape (f, 2)
            Attached to something that moves as the line does.
        normal : Tensor, shape (f, 2)
            Of the line.
        stops : array of int, shape (f, 3)
            As in :class:`loi_torch.mesh.junctions.Parts`.
        """
        held = point.detach()
        moved = ((point - held) * normal).sum(dim=1)
        borders = np.stack([stops[:, 0] == VERTICAL, stops[:, 0] == HORIZONTAL], axis=1).astype(float)
        other, by = torch.as_tensor(borders, device=self.device), torch.zeros_like(moved)
        for kind, line_of in ((EDGE, self._edge_line), (CROSSING, self._crossing_line)):
            rows = np.flatnonzero(stops[:, 0] == kind)
            if len(rows):
                at, line = self.tensor(rows), line_of(stops[rows, 1:])
                other = other.index_copy(0, at, line[:, :2].detach())
                by = by.index_copy(0, at, _moved(line, held[at]))
        across = normal[:, 0] * other[:, 1] - normal[:, 1] * other[:, 0]
        free = across.abs() < STEEP
        across = torch.where(free, torch.ones_like(across), across)
        x = (moved * other[:, 1] - by * normal[:, 1]) / across
        y = (normal[:, 0] * by - other[:, 0] * moved) / across
        return torch.where(free[:, None], point, held + torch.stack([x, y], dim=1))

    def _edge_line(self, ends: Any) -> Tensor:
        """Lines a x + b y + c = 0 through pairs of vertices on the screen, shape (f, 3), with unit normals (a, b)."""
        a, b = (self.corners.index_select(0, self.tensor(ends[:, k])) for k in (0, 1))
        return _normalised(torch.linalg.cross(a, b))

    def _crossing_line(self, pair: Any) -> Tensor:
        """The same of the lines where pairs of triangles are equally near."""
        return _normalised(self._plane(pair[:, 0]) - self._plane(pair[:, 1]))

    def _plane(self, triangle: Any) -> Tensor:
        """The nearness of triangles as a x + b y + c, shape (g, 3)."""
        corners = self.tensor(self.topology.faces[triangle])
        v = corner_rows(self.corners, corners)
        functions = torch.stack([torch.linalg.cross(v[:, (k + 1) % 3], v[:, (k + 2) % 3]) for k in range(3)], dim=1)
        depth = corner_rows(self.depth[:, None], corners)
        return (functions * depth).sum(dim=1) / (v[:, 0] * functions[:, 0]).sum(dim=1, keepdim=True)


def _normalised(line: Tensor) -> Tensor:
    length = torch.linalg.vector_norm(line[:, :2].detach(), dim=1, keepdim=True)
    normalised: Tensor = line / torch.where(length > 0.0, length, torch.ones_like(length))
    return normalised


def _value(line: Tensor, points: Tensor) -> Tensor:
    value: Tensor = (line[:, :2] * points).sum(dim=1) + line[:, 2]
    return value


def _moved(line: Tensor, points: Tensor) -> Tensor:
    """How far lines move along their normals at points of them, which stay: 0, with the gradient of the line."""
    value = _value(line, points)
    return value.detach() - value


def shade(
    frame: Frame,
    samples: Samples,
    lights: Sequence[Light],
    environment: Environment | None,
    *,
    fixed: bool = False,
) -> Tensor:
    """Colours of samples, shape (s, 3); `fixed` holds the points of the surface that they show."""
    total = len(samples.points)
    result = torch.zeros((total, 3), dtype=torch.float64, device=frame.device)
    for number, mesh in enumerate(frame.meshes):
        if len(frame.meshes) > 1:
            at = torch.nonzero(samples.mesh == number)[:, 0]
            if not len(at):
                continue
            own = Samples(*(getattr(samples, name)[at] for name in ("corners", "mesh", "points", "triangle")))
            result = result.index_copy(0, at, _of_mesh(frame, number, mesh, own, lights, environment, fixed=fixed))
        else:
            result = _of_mesh(frame, number, mesh, samples, lights, environment, fixed=fixed)
    return result


def _of_mesh(
    frame: Frame,
    number: int,
    mesh: Mesh,
    samples: Samples,
    lights: Sequence[Light],
    environment: Environment | None,
    *,
    fixed: bool,
) -> Tensor:
    screen = corner_rows(frame.corners, samples.corners)
    shares, functions = weights(screen, samples.points)
    if fixed:
        shares = shares.detach()
    corners = samples.corners - int(frame.first_vertex[number])
    triangle = samples.triangle - int(frame.first_triangle[number])
    lit = bool(lights) or environment is not None
    own_normals = mesh.normals() if lit else None
    columns, widths = [], []
    for value in (
        mesh.vertices if lit else None,
        own_normals if mesh.smooth else None,
        mesh.colours if mesh.per == "vertex" else None,
        mesh.uv,
    ):
        widths.append(0 if value is None else value.shape[1])
        if value is not None:
            columns.append(value)
    if columns:
        table = torch.cat(columns, dim=1)
        points, normals, colours, uv = torch.split(interpolate(table, corners, shares), widths, 1)
    if mesh.per != "vertex":
        rows = mesh.colours.index_select(0, triangle) if mesh.per == "triangle" else mesh.colours
        colours = rows.expand(len(triangle), 3)
    if mesh.texture is not None:
        colours = colours * _textured(mesh, uv, corners, screen, samples.points)
    if own_normals is None:
        return colours
    if not mesh.smooth:
        normals = own_normals.index_select(0, triangle)
    eye = frame.camera.position
    view = unit(eye - points) if frame.camera.extent is None else -frame.camera.axes()[2].expand_as(points)
    # The image's y points down, so what is counterclockwise from outside has a negative volume.
    outwards = torch.where(functions.detach().sum(dim=1, keepdim=True) < 0.0, 1.0, -1.0)
    turned, normals = normals, unit(normals) * outwards
    total = reflected(colours, points, normals, eye, view, mesh.material, list(lights))
    if environment is not None:
        mirrored = 2.0 * (normals * view).sum(dim=1, keepdim=True) * normals - view
        with torch.no_grad():  # a pixel's own angle, and twice that by which the normal turns over it
            footprint = frame.pixel_angle(len(points))
            if mesh.smooth:
                footprint = footprint + 2.0 * _spread(own_normals, turned, corners, screen, samples.points)
        total = total + mesh.material.mirror * environment.radiance(mirrored, footprint)
    return total


def _textured(mesh: Mesh, uv: Tensor, corners: Tensor, screen: Tensor, points: Tensor) -> Tensor:
    with torch.no_grad():
        footprint = _spread(mesh.uv, uv, corners, screen, points)
    pyramid = Pyramid(mesh.texture[None], (True, True))
    place = torch.stack([uv[:, 0], 1.0 - uv[:, 1]], dim=1)
    return pyramid.look_up(torch.zeros(len(uv), dtype=torch.int64, device=uv.device), place, footprint)


def _spread(values: Tensor, here: Tensor, corners: Tensor, screen: Tensor, points: Tensor) -> Tensor:
    """By how much interpolated values differ a pixel further on, shape (s,): the larger of the two directions."""
    rows = corner_rows(values, corners)
    steps = torch.eye(2, dtype=points.dtype, device=points.device)
    lengths = [
        torch.linalg.vector_norm(torch.einsum("sk,skc->sc", weights(screen, points + step)[0], rows) - here, dim=1)
        for step in steps
    ]
    return torch.maximum(lengths[0], lengths[1])

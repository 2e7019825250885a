"""The image of meshes, which torch can differentiate.

Which triangle is seen where is found without gradients (:mod:`loi_torch.mesh.visibility`). Colours are interpolated at
the centres of pixels, and on both sides of each edge that shows, with gradients by vertices, cameras, colours, textures
and lights. The areas of :mod:`loi_torch.mesh.coverage` then mix them, and have the gradient of what moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.arrays import to_numpy
from loi_torch.mesh import visibility
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.coverage import hidden_area, nearest_point
from loi_torch.mesh.interpolation import Samples, corner_rows, interpolate, weights
from loi_torch.mesh.junctions import CROSSING, EDGE, HORIZONTAL, VERTICAL, crossing_stops, settled
from loi_torch.mesh.lighting import Environment, Light, reflected
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.projected import Projected, Seen, View
from loi_torch.mesh.tensors import tensor_of, unit
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
        If `background` has a wrong shape.
    """
    frame = Frame(meshes, camera, height, width)
    behind = frame.behind(background)
    seen = frame.seen
    covered = np.flatnonzero(seen.found >= 0)
    pixels, sides, areas = frame.jumps()
    # Where the near side is of the surface that the centre shows, its colour is known, and is that of all of this side.
    known = frame.near_is_centre(pixels, sides)
    left, right = (np.flatnonzero((side >= 0) & ~same) for side, same in zip(sides, known, strict=True))
    triangle = np.concatenate([seen.found[covered], sides[0][left], sides[1][right]])
    beside = (frame.beside.index_select(0, frame.tensor(one)) for one in (left, right))
    places = torch.cat([frame.centres(covered), *beside])
    colours = shade(frame, frame.samples(triangle, places), lights, environment)
    inner, left_colours, right_colours = torch.split(colours, [len(covered), len(left), len(right)])
    image = behind.index_copy(0, frame.tensor(covered), inner)
    if len(pixels):
        at = frame.tensor(pixels)
        base, centre = behind.index_select(0, at), image.index_select(0, at)
        far = []
        for rows, same, colour in ((left, known[0], left_colours), (right, known[1], right_colours)):
            one = torch.where(torch.as_tensor(same, device=frame.device)[:, None], centre, base)
            far.append(one.index_copy(0, frame.tensor(rows), colour))
        jump = far[1] - far[0]
        image = image.index_add(0, at, areas[:, None] * jump)
    return image.reshape(height, width, 3)


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
    return result.reshape(height, width, 5)


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
        colours = tensor_of("background", background).to(self.device)
        if tuple(colours.shape) == (height, width, 3):
            return colours.reshape(-1, 3)
        if tuple(colours.shape) not in ((), (3,)):
            msg = f"`background` must have shape (3,) or ({height}, {width}, 3), got {tuple(colours.shape)}"
            raise ParameterError(msg)
        return colours.expand(height * width, 3)

    def pixel_angle(self, count: int) -> Tensor:
        """About the angle that a pixel sees, in radians, shape (count,)."""
        height = self.size[0]
        fov = 0.0 if self.camera.extent is not None else float(self.camera.fov.detach())
        return torch.full((count,), float(np.radians(fov)) / height, dtype=torch.float64, device=self.device)

    def jumps(self) -> tuple[Any, tuple[Any, Any], Tensor]:
        """Of every part of an edge that shows: its pixel, the triangles on its left and right, and its area."""
        seen = self.seen
        self.parts = settled(self.projected, seen)
        first, last, turn = self._edge_ends()
        if len(seen.crossing_pixel):
            crossing = self._crossing_ends()
            first, last, turn = (torch.cat(pair) for pair in zip((first, last, turn), crossing, strict=True))
        pixels = np.concatenate([self.parts.pixel, seen.crossing_pixel])
        sides = np.concatenate([self.parts.sides, seen.crossing_sides]).T
        centres = self.centres(pixels)
        if bool((turn == 0.0).any()):
            centres, turn = self._off_edges(pixels, centres, first.detach(), last.detach(), turn)
        self.turn = to_numpy(turn)
        self.beside = nearest_point(first, last, centres)
        return pixels, (sides[0], sides[1]), hidden_area(first - centres, last - centres, turn)

    def near_is_centre(self, pixels: Any, sides: tuple[Any, Any]) -> tuple[Any, Any]:
        """Whether the left, or the right, of parts of edges is on the centre's side and of the surface seen there."""
        sheet, found = self.topology.sheet, self.seen.found[pixels]
        covered = found >= 0
        facing = np.sign(np.linalg.det(self.projected.corners[self.topology.faces]))

        def same(side: Any, towards: float) -> Any:
            alike = (sheet[side] == sheet[found]) & (facing[side] == facing[found]) if len(sheet) else covered
            return covered & (side >= 0) & (self.turn == towards) & alike

        return same(sides[0], 1.0), same(sides[1], -1.0)

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

    def _edge_ends(self) -> tuple[Tensor, Tensor, Tensor]:
        """Both ends of parts of edges, in pixels, as they move; and which way they run around centres."""
        parts, width = self.parts, self.size[1]
        ends = self.tensor(self.topology.ends[parts.edge])
        a, b = self.corners.index_select(0, ends[:, 0]), self.corners.index_select(0, ends[:, 1])
        span = torch.as_tensor(parts.span, device=self.device)
        normal, _ = self._edge_line(ends, None)
        points = []
        for k in (0, 1):
            on_edge = a + span[:, k, None] * (b - a)
            point = on_edge[:, :2] / on_edge[:, 2:]
            points.append(self._stopped(point, normal, parts.stops[:, k]))
        p, q = a.detach(), b.detach()
        x = torch.as_tensor(parts.pixel % width + 0.5, device=self.device)
        y = torch.as_tensor(parts.pixel // width + 0.5, device=self.device)
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
        one, other = seen.crossing_sides[:, 0], seen.crossing_sides[:, 1]
        stops = crossing_stops(self.projected, seen)
        points = []
        for k in (0, 1):
            fixed = torch.as_tensor(seen.crossing_ends[:, 2 * k : 2 * k + 2], device=self.device)
            normal, away = self._crossing_line(one, other, fixed)
            points.append(self._stopped(fixed + normal * away[:, None], normal, stops[:, k]))
        plane = (self._plane(one) - self._plane(other)).detach()
        centres = self.centres(seen.crossing_pixel)
        return points[0], points[1], torch.sign((plane[:, :2] * centres).sum(dim=1) + plane[:, 2])

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
        other = torch.zeros_like(normal)
        other[:, 0] = torch.as_tensor((stops[:, 0] == VERTICAL).astype(float), device=self.device)
        other[:, 1] = torch.as_tensor((stops[:, 0] == HORIZONTAL).astype(float), device=self.device)
        by = torch.zeros_like(moved)
        for kind in (EDGE, CROSSING):
            rows = np.flatnonzero(stops[:, 0] == kind)
            if not len(rows):
                continue
            at, first, last = self.tensor(rows), stops[rows, 1], stops[rows, 2]
            if kind == EDGE:
                line, away = self._edge_line(self.tensor(np.stack([first, last], axis=1)), held[at])
            else:
                line, away = self._crossing_line(first, last, held[at])
            other = other.index_copy(0, at, line)
            by = by.index_copy(0, at, away)
        across = normal[:, 0] * other[:, 1] - normal[:, 1] * other[:, 0]
        free = across.abs() < STEEP
        across = torch.where(free, torch.ones_like(across), across)
        x = (moved * other[:, 1] - by * normal[:, 1]) / across
        y = (normal[:, 0] * by - other[:, 0] * moved) / across
        return torch.where(free[:, None], point, held + torch.stack([x, y], dim=1))

    def _edge_line(self, ends: Tensor, points: Tensor | None) -> tuple[Tensor, Tensor]:
        """Normals of edges on the screen, without gradient, and how far these move at points of them."""
        a, b = self.corners.index_select(0, ends[:, 0]), self.corners.index_select(0, ends[:, 1])
        line = torch.linalg.cross(a, b)
        length = torch.linalg.vector_norm(line[:, :2].detach(), dim=1, keepdim=True)
        line = line / torch.where(length > 0.0, length, torch.ones_like(length))
        normal = line[:, :2].detach()
        if points is None:
            return normal, normal[:, 0]
        value = (line[:, :2] * points).sum(dim=1) + line[:, 2]
        return normal, value.detach() - value

    def _crossing_line(self, one: Any, other: Any, points: Tensor) -> tuple[Tensor, Tensor]:
        """The same of the lines where two triangles are equally near."""
        plane = self._plane(one) - self._plane(other)
        length = torch.linalg.vector_norm(plane[:, :2].detach(), dim=1, keepdim=True)
        plane = plane / torch.where(length > 0.0, length, torch.ones_like(length))
        value = (plane[:, :2] * points).sum(dim=1) + plane[:, 2]
        return plane[:, :2].detach(), value.detach() - value

    def _plane(self, triangle: Any) -> Tensor:
        """The nearness of triangles as a x + b y + c, shape (g, 3)."""
        corners = self.tensor(self.topology.faces[triangle])
        v = corner_rows(self.corners, corners)
        functions = torch.stack([torch.linalg.cross(v[:, (k + 1) % 3], v[:, (k + 2) % 3]) for k in range(3)], dim=1)
        depth = corner_rows(self.depth[:, None], corners)
        return (functions * depth).sum(dim=1) / (v[:, 0] * functions[:, 0]).sum(dim=1, keepdim=True)


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
    columns, widths = [], []
    for value in (
        mesh.vertices if lit else None,
        mesh.normals() if lit and mesh.smooth else None,
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
    if not lit:
        return colours
    if not mesh.smooth:
        normals = mesh.normals().index_select(0, triangle)
    eye = frame.camera.position
    view = unit(eye - points) if frame.camera.extent is None else -frame.camera.axes()[2].expand_as(points)
    # The image's y points down, so what is counterclockwise from outside has a negative volume.
    outwards = torch.where(functions.detach().sum(dim=1, keepdim=True) < 0.0, 1.0, -1.0)
    normals = unit(normals) * outwards
    total = reflected(colours, points, normals, eye, view, mesh.material, list(lights))
    if environment is not None:
        mirrored = 2.0 * (normals * view).sum(dim=1, keepdim=True) * normals - view
        footprint = _bend(frame, mesh, samples, corners, screen)
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


def _bend(frame: Frame, mesh: Mesh, samples: Samples, corners: Tensor, screen: Tensor) -> Tensor:
    """The angle of a pixel after reflection: twice that by which the normal turns, and its own, in radians."""
    with torch.no_grad():
        angle = frame.pixel_angle(len(samples.points))
        if mesh.smooth:
            unturned = interpolate(mesh.normals(), corners, weights(screen, samples.points)[0])
            angle = angle + 2.0 * _spread(mesh.normals(), unturned, corners, screen, samples.points)
        return angle

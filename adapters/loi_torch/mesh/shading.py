"""Colours of surface samples, with gradients with respect to vertices, cameras, colours, textures and lights."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from loi_torch.mesh.barycentric import SurfaceSamples, barycentric_weights, gather_corners, interpolate
from loi_torch.mesh.lighting import Environment, Light, blinn_phong
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.rasterize import Frame
from loi_torch.mesh.tensors import unit
from loi_torch.mesh.textures import MipPyramid

__all__ = ["shade"]


def shade(
    frame: Frame,
    samples: SurfaceSamples,
    lights: Sequence[Light],
    environment: Environment | None,
    *,
    attached: bool = False,
) -> Tensor:
    """Return the colours of samples, shape (s, 3).

    Samples are fixed in the image; with `attached`, they move with the surface, at constant barycentric coordinates.
    """
    if len(frame.meshes) == 1:
        return _shade_mesh(frame, 0, samples, lights, environment, attached=attached)
    result = torch.zeros((len(samples.points), 3), dtype=torch.float64)
    for index in range(len(frame.meshes)):
        rows = torch.nonzero(samples.mesh == index)[:, 0]
        if len(rows):
            of_mesh = SurfaceSamples(*(column[rows] for column in samples))
            colours = _shade_mesh(frame, index, of_mesh, lights, environment, attached=attached)
            result = result.index_copy(0, rows, colours)
    return result


def _shade_mesh(
    frame: Frame,
    index: int,
    samples: SurfaceSamples,
    lights: Sequence[Light],
    environment: Environment | None,
    *,
    attached: bool,
) -> Tensor:
    mesh = frame.meshes[index]
    screen = gather_corners(frame.corners, samples.corners)
    weights, functions = barycentric_weights(screen, samples.points)
    if attached:
        weights = weights.detach()
    corners = samples.corners - int(frame.first_vertex[index])
    triangle = samples.triangle - int(frame.first_triangle[index])
    is_lit = bool(lights) or environment is not None
    mesh_normals = mesh.normals() if is_lit else None
    attributes = (
        mesh.vertices if is_lit else None,
        mesh_normals if mesh.smooth else None,
        mesh.colours if mesh.per == "vertex" else None,
        mesh.uv,
    )
    columns = [value for value in attributes if value is not None]
    if columns:
        widths = [0 if value is None else value.shape[1] for value in attributes]
        points, normals, colours, uv = torch.split(interpolate(torch.cat(columns, dim=1), corners, weights), widths, 1)
    if mesh.per != "vertex":
        rows = mesh.colours.index_select(0, triangle) if mesh.per == "triangle" else mesh.colours
        colours = rows.expand(len(triangle), 3)
    if mesh.texture is not None:
        colours = colours * _texture_colours(mesh, uv, corners, screen, samples.points)
    if mesh_normals is None:
        return colours
    if not mesh.smooth:
        normals = mesh_normals.index_select(0, triangle)
    eye = frame.camera.position
    view = unit(eye - points) if frame.camera.extent is None else -frame.camera.axes()[2].expand_as(points)
    # The image's y axis points down, so the volume of a triangle that is counterclockwise from outside is negative.
    facing = torch.where(functions.detach().sum(dim=1, keepdim=True) < 0.0, 1.0, -1.0)
    unit_normals = unit(normals) * facing
    total = blinn_phong(colours, points, unit_normals, eye, view, mesh.material, list(lights))
    if environment is not None:
        mirrored = 2.0 * (unit_normals * view).sum(dim=1, keepdim=True) * unit_normals - view
        with torch.no_grad():  # a mirrored ray turns by twice the angle of the normal
            footprint = frame.pixel_angle(len(points))
            if mesh.smooth:
                footprint = footprint + 2.0 * _change_per_pixel(mesh_normals, normals, corners, screen, samples.points)
        total = total + mesh.material.mirror * environment.radiance(mirrored, footprint)
    return total


def _texture_colours(mesh: Mesh, uv: Tensor, corners: Tensor, screen: Tensor, points: Tensor) -> Tensor:
    with torch.no_grad():
        footprint = _change_per_pixel(mesh.uv, uv, corners, screen, points)
    pyramid = MipPyramid(mesh.texture[None], (True, True))
    position = torch.stack([uv[:, 0], 1.0 - uv[:, 1]], dim=1)
    return pyramid.sample(torch.zeros(len(uv), dtype=torch.int64, device=uv.device), position, footprint)


def _change_per_pixel(values: Tensor, interpolated: Tensor, corners: Tensor, screen: Tensor, points: Tensor) -> Tensor:
    """Return the larger change of interpolated values to the next pixel in x or y, shape (s,)."""
    rows = gather_corners(values, corners)
    lengths = [
        torch.linalg.vector_norm(
            torch.einsum("sk,skc->sc", barycentric_weights(screen, points + step)[0], rows) - interpolated, dim=1
        )
        for step in torch.eye(2, dtype=points.dtype, device=points.device)
    ]
    return torch.maximum(lengths[0], lengths[1])

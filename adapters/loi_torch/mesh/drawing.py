"""Differentiable images of meshes: shaded pixels, blended at every visible edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.keywords import suggest_keywords
from loi_torch.mesh.barycentric import barycentric_weights, gather_corners, interpolate
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.edge_blending import edge_contributions
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.rasterize import Frame
from loi_torch.mesh.shading import shade

__all__ = ["draw", "draw_positions"]


@suggest_keywords
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
    """Draw meshes with analytically anti-aliased outlines, on the processor.

    Tensors may be on any mixture of devices. They are copied to the processor, the image is copied to a GPU that holds
    a mesh or else the camera, and gradients arrive on the devices of their tensors.

    Parameters
    ----------
    meshes : sequence of Mesh
        They may intersect.
    camera : Camera
    height, width : int
        Size of the image in pixels.
    lights : sequence of Light
        Without lights and environment, surfaces show their colours unshaded.
    environment : Environment, optional
        Reflected by mirrors.
    background : float, array of shape (3,) or (height, width, 3), or Environment
        Linear RGB behind all meshes.

    Returns
    -------
    Tensor, shape (height, width, 3), float64
        Linear RGB, differentiable.

    Raises
    ------
    ParameterError
        If an argument has a wrong type or shape.
    BackendNotFoundError
        If Numba is not installed.
    """
    if isinstance(lights, Light):
        msg = "`lights` must be a list of Light, got a single Light"
        raise ParameterError(msg)
    frame = Frame(meshes, camera, height, width)
    background_colours = frame.background(background)
    centre_triangle = frame.visible.centre_triangle
    covered = np.flatnonzero(centre_triangle >= 0)
    edges = edge_contributions(frame)
    # A side that shows the surface at the centre takes the colour of the centre; other sides are shaded at the edge.
    sides = list(zip(edges.triangles, edges.has_centre_colour, strict=True))
    rows = [np.flatnonzero((triangle >= 0) & ~has_centre_colour) for triangle, has_centre_colour in sides]
    triangles = [triangle[side_rows] for (triangle, _), side_rows in zip(sides, rows, strict=True)]
    points = [edges.points.index_select(0, frame.index_tensor(side_rows)) for side_rows in rows]
    samples = frame.samples(
        np.concatenate([centre_triangle[covered], *triangles]), torch.cat([frame.pixel_centres(covered), *points])
    )
    shaded = shade(frame, samples, lights, environment)
    centre_colours, *side_colours = torch.split(shaded, [len(covered), *map(len, rows)])
    image = background_colours.index_copy(0, frame.index_tensor(covered), centre_colours)
    if len(edges.pixels):
        pixels = frame.index_tensor(edges.pixels)
        uncovered, centre = background_colours.index_select(0, pixels), image.index_select(0, pixels)
        left, right = (
            torch.where(torch.as_tensor(has_centre_colour)[:, None], centre, uncovered).index_copy(
                0, frame.index_tensor(side_rows), colours
            )
            for (_, has_centre_colour), side_rows, colours in zip(sides, rows, side_colours, strict=True)
        )
        image = image.index_add(0, pixels, edges.areas[:, None] * (right - left))
    return frame.finished(image)


@suggest_keywords
def draw_positions(
    meshes: Sequence[Mesh],
    camera: Camera,
    height: int,
    width: int,
    *,
    lights: Sequence[Light] = (),
    environment: Environment | None = None,
    background: Any = 0.0,
) -> Tensor:
    """Draw colours and image positions of surface points, which RGBXY compares (Xing et al. 2022).

    The arguments are as for :func:`draw`. Outlines are aliased: each pixel shows the surface at its centre.

    Returns
    -------
    Tensor, shape (height, width, 5), float64
        Linear RGB, and x and y, 0 to 1 over the image. A covered pixel's five numbers are differentiated as its surface
        point moves; the positions of uncovered pixels are constant.
    """
    frame = Frame(meshes, camera, height, width)
    covered = np.flatnonzero(frame.visible.centre_triangle >= 0)
    centres = frame.pixel_centres(np.arange(height * width))
    size = torch.tensor([width, height], dtype=torch.float64)
    result = torch.cat([frame.background(background), centres / size], dim=1)
    if len(covered):
        rows = frame.index_tensor(covered)
        samples = frame.samples(frame.visible.centre_triangle[covered], centres.index_select(0, rows))
        screen = gather_corners(frame.corners, samples.corners)
        weights = barycentric_weights(screen, samples.points)[0].detach()
        colours = shade(frame, samples, lights, environment, attached=True)
        points = interpolate(frame.vertices, samples.corners, weights)
        projected = camera.project(points, height, width)[0]
        positions = projected[:, :2] / projected[:, 2:] / size
        result = result.index_copy(0, rows, torch.cat([colours, positions], dim=1))
    return frame.finished(result)

"""Rasterise, interpolate and antialias, as Laine et al. (2020) describe them; row 0 is the bottom of the image."""

from __future__ import annotations

import torch
from torch import Tensor


class RasterizeCudaContext:
    """A context without state."""


def rasterize(glctx: RasterizeCudaContext, pos: Tensor, tri: Tensor, resolution: list[int]) -> tuple[Tensor, Tensor]:
    """Return (u, v, z/w, triangle + 1), shape (N, H, W, 4), and zeros for the derivatives of u and v.

    Vertices `pos` in clip space have shape (N, V, 4), triangles `tri` (F, 3).
    """
    height, width = resolution
    corners = pos[:, tri.long()]
    points = corners[..., [0, 1, 3]]
    normals = torch.linalg.cross(points.roll(-1, -2), points.roll(-2, -2))
    volume = (normals * points).sum(-1).mean(-1)
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([2.0 * x / width - 1.0, 2.0 * y / height - 1.0, torch.ones_like(x)], -1)
    planes = normals / torch.where(volume.abs() < 1e-9, torch.inf, volume)[..., None, None]
    weights = torch.einsum("nfki,hwi->nhwfk", planes, pixels)
    nearness = torch.where((weights >= 0.0).all(-1), weights.sum(-1), 0.0).detach()
    covered, triangle = nearness.amax(-1) > 0.0, nearness.argmax(-1)
    chosen = weights.gather(-2, triangle[..., None, None].expand(*triangle.shape, 1, 3))[..., 0, :]
    total = torch.where(covered, chosen.sum(-1), 1.0)  # 1 / w
    barycentric = chosen / total[..., None]
    z = corners[torch.arange(len(pos))[:, None, None], triangle][..., 2]
    depth = (barycentric * z).sum(-1) * total
    raster = torch.stack([barycentric[..., 0], barycentric[..., 1], depth, (triangle + 1).to(depth)], -1)
    return torch.where(covered[..., None], raster, 0.0), torch.zeros_like(raster)


def interpolate(attr: Tensor, rast: Tensor, tri: Tensor) -> tuple[Tensor, Tensor]:
    """Return attributes (N, H, W, A), of `attr` (1, V, A), black where there is no triangle, and no derivatives."""
    triangle = rast[..., 3].detach().long()
    weights = torch.stack([rast[..., 0], rast[..., 1], 1.0 - rast[..., 0] - rast[..., 1]], -1)
    values = attr[0][tri.long()[(triangle - 1).clamp(min=0)]]
    image = (weights[..., None] * values).sum(-2)
    return torch.where(triangle[..., None] > 0, image, 0.0), torch.empty(0)


def antialias(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor) -> Tensor:
    """Blend neighbouring pixels across the nearer triangle's edges that no other triangle shares."""
    count, height, width, channels = color.shape
    colours, triangle = color.reshape(-1, channels), rast[..., 3].detach().long().reshape(-1) - 1
    depth = torch.where(triangle >= 0, rast[..., 2].detach().reshape(-1), torch.inf)
    screen = 0.5 * (pos[..., :2] / pos[..., 3:] + 1.0) * torch.tensor([width, height])
    edges = torch.stack([tri.long(), tri.long().roll(-1, 1)], -1)
    ordered = edges.sort(-1).values
    unshared = (ordered[:, :, None, None] == ordered[None, None]).all(-1).sum((2, 3)) == 1
    number = torch.arange(len(colours)).reshape(count, height, width)
    result = colours
    for axis, (first, second) in enumerate(((number[:, :, :-1], number[:, :, 1:]), (number[:, :-1], number[:, 1:]))):
        pair = torch.stack([first.flatten(), second.flatten()])
        pair = pair[:, triangle[pair[0]] != triangle[pair[1]]]
        swapped = depth[pair[0]] > depth[pair[1]]
        near, far = torch.where(swapped, pair[1], pair[0]), torch.where(swapped, pair[0], pair[1])
        centre = torch.stack([near % width, near // width % height], -1) + 0.5
        ends = screen[(near // (height * width))[:, None, None], edges[triangle[near]]]
        (begin, end), (low, high) = ends[..., axis].unbind(-1), ends[..., 1 - axis].unbind(-1)
        level = centre[:, 1 - axis, None]
        crosses = (low > level) != (high > level)
        crossing = begin + (level - low) / torch.where(crosses, high - low, 1.0) * (end - begin)
        distance = (crossing - centre[:, axis, None]) * torch.where(swapped, -1.0, 1.0)[:, None]
        valid = unshared[triangle[near]] & crosses & (distance >= 0.0) & (distance <= 1.0)
        nearest = distance.gather(1, valid.int().argmax(1, keepdim=True))[:, 0]
        weight = torch.where(valid.any(1), nearest - 0.5, 0.0)
        change = weight[:, None] * (colours[near] - colours[far])
        result = result.index_add(0, torch.where(weight > 0.0, far, near), change)
    return result.reshape(color.shape)

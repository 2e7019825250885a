"""A stand-in for gsplat on a processor, with the arguments and results of `rasterization` that gsplat documents."""

from __future__ import annotations

from typing import Any

import torch
from kornia.geometry.conversions import quaternion_to_rotation_matrix
from torch import Tensor


def rasterization(
    means: Tensor,  # (N, 3)
    quats: Tensor,  # (N, 4), wxyz, of any length
    scales: Tensor,  # (N, 3)
    opacities: Tensor,  # (N,)
    colors: Tensor,  # (N, D)
    viewmats: Tensor,  # (C, 4, 4), world to camera
    Ks: Tensor,  # noqa: N803  # (C, 3, 3); gsplat's name
    width: int,
    height: int,
    *,
    eps2d: float = 0.3,
    packed: bool = True,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Return images (C, H, W, D), opacities (C, H, W, 1) and a dict: Gaussians from front to back, exactly sorted."""
    axes = quaternion_to_rotation_matrix(quats) * scales[:, None, :]
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    images, alphas = [], []
    for view, intrinsics in zip(viewmats, Ks, strict=True):
        points = means @ view[:3, :3].T + view[:3, 3]
        order = torch.argsort(points[:, 2].detach())
        points, factor = points[order], (view[:3, :3] @ axes)[order]
        depth = points[:, 2]
        pixels = (points @ intrinsics.T)[:, :2] / depth[:, None]
        zero = torch.zeros_like(depth)
        slopes = torch.stack([1 / depth, zero, -points[:, 0] / depth**2, zero, 1 / depth, -points[:, 1] / depth**2], -1)
        projected = intrinsics[:2, :2] @ slopes.reshape(-1, 2, 3) @ factor
        precision = torch.linalg.inv(projected @ projected.transpose(1, 2) + eps2d * torch.eye(2))
        right, down = columns - pixels[:, 0, None, None], rows - pixels[:, 1, None, None]
        precision = precision[..., None, None]
        exponent = precision[:, 0, 0] * right**2 + 2 * precision[:, 0, 1] * right * down + precision[:, 1, 1] * down**2
        alpha = opacities[order, None, None] * torch.exp(-0.5 * exponent)
        transmittance = torch.cumprod(1 - alpha, dim=0)
        weights = alpha * torch.cat([torch.ones_like(alpha[:1]), transmittance[:-1]])
        images.append(torch.einsum("nhw,nd->hwd", weights, colors[order]))
        alphas.append(1 - transmittance[-1][..., None])
    return torch.stack(images), torch.stack(alphas), {}

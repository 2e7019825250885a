"""Fit an image by random Gaussians with gsplat: ``python -m examples.loops.with_gsplat_image``.

It needs gsplat, ``pip install gsplat``, and a CUDA GPU. Here pixel losses are enough; see the guide.
"""

from collections.abc import Callable
from typing import Any

import torch
from gsplat import rasterization
from kornia.losses import ssim_loss

import loi_torch
from examples.loops.scenes import quadrants

device = "cuda" if torch.cuda.is_available() else "cpu"
photograph, view, intrinsics = quadrants.build(device)
size = quadrants.SIZE
Loss = Callable[[torch.Tensor, torch.Tensor], Any]


def l1_ssim(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the loss that splats are trained with, shape ()."""
    dssim: torch.Tensor = ssim_loss(image.permute(0, 3, 1, 2), target.permute(0, 3, 1, 2), window_size=11)
    return 0.8 * (image - target).abs().mean() + 0.4 * dssim  # a half of 1 - SSIM


def psnr(loss: Loss) -> float:
    """Return the PSNR of the image that Adam reaches, in dB."""
    means, quats, scales, opacities, colours = splat = quadrants.gaussians(device)
    optimizer = torch.optim.Adam(splat, lr=0.03)
    for _ in range(300):
        optimizer.zero_grad()
        shown = torch.sigmoid(opacities), torch.sigmoid(colours)
        image = rasterization(means, quats, scales, *shown, view, intrinsics, size, size, packed=False)[0]
        loss(image, photograph).backward()
        optimizer.step()
    return float(-10.0 * torch.log10((image.detach() - photograph).square().mean()))


losses: dict[str, Loss] = {"L2": torch.nn.MSELoss(), "L1 and SSIM": l1_ssim, "loi": loi_torch.LOILoss()}
for name, loss in losses.items():
    print(f"{name}: {psnr(loss):.1f} dB")

"""The image that gsplat's own example fits, smaller, its camera, and the random Gaussians of its start."""

import torch

SIZE, COUNT = 32, 50  # 256 and 100,000 there


def build(device: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the photograph, shape (1, H, W, 3), the camera's matrix, (1, 4, 4), and its intrinsics, (1, 3, 3)."""
    photograph = torch.ones(1, SIZE, SIZE, 3)
    photograph[:, : SIZE // 2, : SIZE // 2] = torch.tensor([1.0, 0.0, 0.0])
    photograph[:, SIZE // 2 :, SIZE // 2 :] = torch.tensor([0.0, 0.0, 1.0])
    view = torch.eye(4)[None]
    view[0, 2, 3] = 8.0
    intrinsics = torch.tensor([[[0.5 * SIZE, 0.0, 0.5 * SIZE], [0.0, 0.5 * SIZE, 0.5 * SIZE], [0.0, 0.0, 1.0]]])
    return photograph.to(device), view.to(device), intrinsics.to(device)


def gaussians(device: str) -> list[torch.Tensor]:
    """Return means, quaternions, scales, and the opacities and colours before the sigmoid, as unknowns."""
    torch.manual_seed(0)
    means, scales, colours = 2.0 * torch.rand(COUNT, 3) - 1.0, torch.rand(COUNT, 3), torch.rand(COUNT, 3)
    splat = means, torch.randn(COUNT, 4), scales, torch.ones(COUNT), colours
    return [value.to(device).requires_grad_() for value in splat]

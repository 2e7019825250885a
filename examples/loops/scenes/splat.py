"""A splat of twelve Gaussians, and the intrinsics of its camera."""

import torch

HEIGHT, WIDTH = 48, 64


def build(device: str) -> tuple[tuple[torch.Tensor, ...], torch.Tensor]:
    """Return means, quaternions, scales, opacities and colours for gsplat, and intrinsics, shape (1, 3, 3)."""
    torch.manual_seed(1)
    means, quats = torch.rand(12, 3) - 0.5, torch.randn(12, 4)
    scales, opacities = 0.1 + 0.2 * torch.rand(12, 3), torch.full((12,), 0.9)
    gaussians = means, quats, scales, opacities, torch.rand(12, 3)
    intrinsics = torch.tensor([[[60.0, 0.0, 0.5 * WIDTH], [0.0, 60.0, 0.5 * HEIGHT], [0.0, 0.0, 1.0]]], device=device)
    return tuple(value.to(device) for value in gaussians), intrinsics

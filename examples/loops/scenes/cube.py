"""The cube of nvdiffrast's own sample, with its camera and turns of it."""

import torch
from kornia.geometry.quaternion import Quaternion

COLOURS = [[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.6, 0.0]]
TO_CLIP = [[2.5, 0.0, 0.0, 0.0], [0.0, 2.5, 0.0, 0.0], [0.0, 0.0, -1.04, 1.6], [0.0, 0.0, -1.0, 3.5]]


def build(device: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return positions, shape (24, 3), triangles (12, 3), colours (24, 3), and the matrix to clip space, (4, 4)."""
    corners = torch.tensor([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = torch.tensor([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = 4 * torch.arange(6)[:, None, None] + torch.tensor([[0, 1, 2], [0, 2, 3]])
    colours = torch.tensor(COLOURS).repeat_interleave(4, 0)
    faces = triangles.reshape(12, 3).int()
    return (
        corners[quads.flatten()].to(device),
        faces.to(device),
        colours.to(device),
        torch.tensor(TO_CLIP, device=device),
    )


def turns(count: int, device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Return random quaternions, shape (count, 4), wxyz, and others 20 to 80 degrees off."""
    torch.manual_seed(0)
    truth, axis = (torch.nn.functional.normalize(torch.randn(count, size)) for size in (4, 3))
    angles = torch.deg2rad(torch.linspace(20.0, 80.0, count))[:, None]
    start = Quaternion.from_axis_angle(angles * axis) * Quaternion(truth)
    return truth.to(device), start.data.to(device)

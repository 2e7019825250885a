"""The loop of the README on torch, as a whole program: ``python -m examples.loops.with_torch``."""

import torch

import loi_torch

height, width = 64, 96
y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")


def render(centre: torch.Tensor) -> torch.Tensor:
    """A soft disk of radius 8 on black, (height, width, 3)."""
    inside = torch.sigmoid((64 - (x - centre[0]) ** 2 - (y - centre[1]) ** 2) / 8)
    return inside[..., None] * torch.tensor([1.0, 0.6, 0.1])


photograph = render(torch.tensor([75.0, 45.0]))
centre = torch.tensor([15.0, 15.0], requires_grad=True)
optimizer = torch.optim.Adam([centre], lr=1.0)

loss = loi_torch.LOILoss()
for _ in range(200):
    optimizer.zero_grad()
    loss(render(centre), photograph).backward()
    optimizer.step()

print(*(round(coordinate, 1) for coordinate in centre.tolist()))

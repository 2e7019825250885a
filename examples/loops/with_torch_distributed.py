"""Find a ball in photographs from three sides, which two processes share.

``python -m torch.distributed.run --standalone --nproc-per-node 2 -m examples.loops.with_torch_distributed``
"""

import math
from datetime import timedelta

import torch
import torch.distributed as dist

import loi_torch

height, width, views = 64, 64, 3
y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")


def render(centre: torch.Tensor, view: int) -> torch.Tensor:
    """Render a soft ball of radius 8 on black from one of the sides, shape (height, width, 3)."""
    angle = math.pi * view / views
    centre_x = width / 2 + centre[0] * math.cos(angle) + centre[2] * math.sin(angle)
    inside = torch.sigmoid((64 - (x - centre_x) ** 2 - (y - centre[1]) ** 2) / 8)
    return inside[..., None] * torch.tensor([1.0, 0.6, 0.1])


dist.init_process_group("gloo", timeout=timedelta(seconds=60))  # "nccl" on GPUs
own_views = range(dist.get_rank(), views, dist.get_world_size())
target = torch.tensor([15.0, 45.0, -10.0])
photographs = {view: render(target, view) for view in own_views}
loss = loi_torch.LOILoss()
centre = torch.tensor([-15.0, 15.0, 10.0], requires_grad=True)
optimizer = torch.optim.Adam([centre], lr=1.0)

for _ in range(200):
    optimizer.zero_grad()
    for view, photograph in photographs.items():
        (loss(render(centre, view), photograph) / views).backward()  # a term of the mean over the views of all ranks
    dist.all_reduce(centre.grad)
    optimizer.step()

if dist.get_rank() == 0:
    print(*(round(value, 1) for value in centre.tolist()))
dist.destroy_process_group()

"""Find the position of a mesh that does not overlap its photograph, on torch alone.

``python -m examples.loops.with_mesh``
"""

from dataclasses import replace

import torch

import loi_torch
from loi_torch.mesh import Camera, Light, box, draw

height, width = 64, 96
camera, lights = Camera((0.0, 2.0, 8.0), fov=40.0), [Light(direction=(-1.0, -2.0, -3.0))]
crate = box(colours=(0.8, 0.4, 0.2))  # or read_mesh("crate.glb")


def render(position: torch.Tensor) -> torch.Tensor:
    """Render the crate at a position, shape (height, width, 3)."""
    return draw([replace(crate, vertices=crate.vertices + position)], camera, height, width, lights=lights)


photograph = render(torch.tensor([2.0, -0.8, 0.0]))
position = torch.tensor([-2.0, 0.9, 0.0], requires_grad=True)
optimizer = torch.optim.Adam([position], lr=0.05)

loss = loi_torch.LOILoss()
for _ in range(300):
    optimizer.zero_grad()
    loss(render(position), photograph).backward()
    optimizer.step()

print(*(round(value, 1) for value in position.tolist()))

"""
Torch: a soft renderer of your own
==================================

``LOILoss`` replaces the loss of any differentiable torch renderer. Three lanterns on a dark wall start away from their
positions in the photograph.
"""

import torch

from loi_core import FarToNear, ScaleSpace
from loi_torch import LOILoss
from pictures import Film

height, width = 64, 96
y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
colours = torch.tensor([[0.95, 0.05, 0.05], [0.05, 0.85, 0.05], [0.05, 0.05, 1.0]])
radii = torch.tensor([7.0, 9.0, 11.0])


def render(positions: torch.Tensor) -> torch.Tensor:
    """Return three soft disks, (height, width, 3), at positions (3, 2) in pixels."""
    image = torch.full((height, width, 3), 0.05)
    for position, radius, colour in zip(positions, radii, colours, strict=True):
        distance = torch.hypot(x - position[0], y - position[1])
        image = torch.lerp(image, colour, torch.sigmoid(2.0 * (radius - distance))[..., None])
    return image


truth = torch.tensor([[16.0, 18.0], [78.0, 16.0], [46.0, 48.0]])
start = torch.tensor([[48.0, 30.0], [14.0, 50.0], [80.0, 46.0]])
photograph = render(truth)

# %%
# The wide scales come first; ``FarToNear`` decides when to advance.

steps = 200
positions = start.clone().requires_grad_()
optimizer = torch.optim.Adam([positions], lr=1.0)
losses = [LOILoss(scales) for scales in ScaleSpace.far_to_near(height, width)]
schedule = FarToNear(len(losses), steps)
film = Film(photograph)
for _ in range(steps):
    optimizer.zero_grad()
    image = render(positions)
    loss = losses[schedule.stage](image, photograph)
    loss.backward()
    optimizer.param_groups[0]["lr"] = 1.0 - 0.98 * schedule.passed
    optimizer.step()
    schedule.step(float(loss))
    film.keep(image)

# %%
film.show()

# %%
film.play()

# %%
start_error, final_error = (
    float(torch.linalg.vector_norm(params - truth, dim=1).max()) for params in (start, positions.detach())
)
print(f"the worst is off by {start_error:.1f} px at the start, {final_error:.3f} px at the end")
assert final_error < 0.2

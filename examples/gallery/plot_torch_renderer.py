"""
Torch: a soft renderer of your own
==================================

Anything that torch differentiates can be fitted: ``LOILoss`` stands where your loss was. Three lanterns on a dark wall
hang elsewhere than in their photograph.
"""

import torch

from loi_core import FarToNear, ScaleSpace
from loi_torch import LOILoss
from pictures import Film

height, width = 64, 96
y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
colours = torch.tensor([[0.95, 0.05, 0.05], [0.05, 0.85, 0.05], [0.05, 0.05, 1.0]])
radii = torch.tensor([7.0, 9.0, 11.0])


def render(places: torch.Tensor) -> torch.Tensor:
    """Three soft disks, (height, width, 3); ``places`` are in pixels, (3, 2)."""
    image = torch.full((height, width, 3), 0.05)
    for place, radius, colour in zip(places, radii, colours, strict=True):
        away = torch.hypot(x - place[0], y - place[1])
        image = torch.lerp(image, colour, torch.sigmoid(2.0 * (radius - away))[..., None])
    return image


truth = torch.tensor([[16.0, 18.0], [78.0, 16.0], [46.0, 48.0]])
start = torch.tensor([[48.0, 30.0], [14.0, 50.0], [80.0, 46.0]])
photograph = render(truth)

# %%
# The wide scales come first; ``FarToNear`` says when they have done their part.

steps = 200
places = start.clone().requires_grad_()
optimizer = torch.optim.Adam([places], lr=1.0)
losses = [LOILoss(photograph, scales) for scales in ScaleSpace.far_to_near(height, width)]
schedule = FarToNear(len(losses), steps)
film = Film(photograph)
for _ in range(steps):
    optimizer.zero_grad()
    image = render(places)
    loss = losses[schedule.stage](image)
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
before, after = (float(torch.linalg.vector_norm(one - truth, dim=1).max()) for one in (start, places.detach()))
print(f"the worst is off by {before:.1f} px at the start, {after:.3f} px at the end")
assert after < 0.2

"""Localise a camera in a splat with gsplat: ``python -m examples.loops.with_gsplat``.

It needs gsplat, ``pip install gsplat``, and a CUDA GPU. gsplat's images, (C, H, W, 3), go into the loss as they are.
"""

import torch
from gsplat import rasterization
from kornia.geometry.liegroup import Se3, So3

import loi_torch
from examples.loops.scenes import splat

device = "cuda" if torch.cuda.is_available() else "cpu"
gaussians, intrinsics = splat.build(device)


def render(shift: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Render the splat, shifted in world units and rotated about the origin in radians, shape (1, 48, 64, 3)."""
    pose = Se3(So3.exp(angles), shift + torch.tensor([0.0, 0.0, 6.0], device=device))
    images: torch.Tensor = rasterization(*gaussians, pose.matrix()[None], intrinsics, splat.WIDTH, splat.HEIGHT)[0]
    return images


truth = torch.tensor([1.2, -0.9, 0.5], device=device), torch.tensor([0.2, 0.3, -0.4], device=device)
photograph = render(*truth).detach()


def error(loss: torch.nn.Module) -> float:
    """Return the error of the shift that Adam reaches from the far side of the image, in world units."""
    shift = torch.tensor([-1.5, 0.9, 0.0], device=device, requires_grad=True)
    angles = torch.zeros(3, device=device, requires_grad=True)
    optimizer = torch.optim.Adam([{"params": [shift], "lr": 0.03}, {"params": [angles], "lr": 0.01}])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 300)
    for _ in range(300):
        optimizer.zero_grad()
        loss(render(shift, angles), photograph).backward()
        optimizer.step()
        schedule.step()
    return float(torch.linalg.vector_norm(shift.detach() - truth[0]))


print("L2 ", round(error(torch.nn.MSELoss()), 2))
print("loi", round(error(loi_torch.LOILoss()), 2))

"""Find the pose of a CT under X-rays with nanodrr: ``python -m examples.loops.with_nanodrr``.

It needs ``pip install nanodrr``, and runs on a processor. nanodrr's images are (B, 1, H, W), as kornia's.
"""

import torch
from nanodrr.camera import make_rt_inv

from examples.loops.scenes import bone
from loi_torch.kornia import LOILoss

subject, drr = bone.build()


def render(angles: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Render a radiograph, shape (1, 1, H, W), of angles in degrees and a shift in mm."""
    camera = make_rt_inv(angles[None], shift[None] + torch.tensor([[0.0, 850.0, 0.0]]), "AP", subject.isocenter)
    image: torch.Tensor = drr(subject, camera, n_samples=64, backend="torch")
    return image


truth = torch.tensor([20.0, -15.0, 10.0]), torch.tensor([70.0, 0.0, -60.0])
with torch.no_grad():
    brightest = render(*truth).max()
    radiograph = render(*truth) / brightest


def error(loss: torch.nn.Module) -> float:
    """Return the error of the shift that Adam reaches, in mm."""
    angles = torch.zeros(3, requires_grad=True)
    shift = torch.tensor([-70.0, 0.0, 60.0], requires_grad=True)
    optimizer = torch.optim.Adam([{"params": [angles], "lr": 0.5}, {"params": [shift], "lr": 3.0}])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 200)
    for _ in range(200):
        optimizer.zero_grad()
        loss(render(angles, shift) / brightest, radiograph).backward()
        optimizer.step()
        schedule.step()
    return float(torch.linalg.vector_norm(shift.detach() - truth[1]))


print("L2 ", round(error(torch.nn.MSELoss()), 1))
print("loi", round(error(LOILoss()), 1))

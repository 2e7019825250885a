"""Find the pose of a CT under X-rays with nanodrr: ``python -m examples.loops.with_nanodrr``.

It needs ``pip install nanodrr``, and runs on a processor. nanodrr's images are (B, 1, H, W), as kornia's.
"""

import torch
from nanodrr.camera import make_rt_inv
from nanodrr.data import Subject
from nanodrr.drr import DRR
from torchio import ScalarImage

from loi_torch.kornia import LOILoss

grid = torch.linspace(-1.0, 1.0, 40)
x, y, z = torch.meshgrid(grid, grid, grid, indexing="ij")
bone = ((x / 0.5) ** 2 + (y / 0.3) ** 2 + (z / 0.7) ** 2 < 1.0) | ((x - 0.3) ** 2 + y**2 + (z - 0.5) ** 2 < 0.1)
hounsfield = torch.where(bone, 1000.0, -1000.0)  # bone in air
to_mm = torch.diag(torch.tensor([5.0, 5.0, 5.0, 1.0]))
subject = Subject.from_images(ScalarImage(tensor=hounsfield[None], affine=to_mm))
drr = DRR.from_carm_intrinsics(1020.0, 7.0, 7.0, 0.0, 0.0, 64, 64)


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

"""A CT of a bone in air, 200 mm wide, and a C-arm for nanodrr."""

import torch
from nanodrr.data import Subject
from nanodrr.drr import DRR
from torchio import ScalarImage


def build() -> tuple[Subject, DRR]:
    """Return the CT and a renderer of its radiographs, shape (1, 1, 64, 64)."""
    grid = torch.linspace(-1.0, 1.0, 40)
    x, y, z = torch.meshgrid(grid, grid, grid, indexing="ij")
    bone = ((x / 0.5) ** 2 + (y / 0.3) ** 2 + (z / 0.7) ** 2 < 1.0) | ((x - 0.3) ** 2 + y**2 + (z - 0.5) ** 2 < 0.1)
    hounsfield = torch.where(bone, 1000.0, -1000.0)
    to_mm = torch.diag(torch.tensor([5.0, 5.0, 5.0, 1.0]))
    subject = Subject.from_images(ScalarImage(tensor=hounsfield[None], affine=to_mm))
    return subject, DRR.from_carm_intrinsics(1020.0, 7.0, 7.0, 0.0, 0.0, 64, 64)

"""The objective of each setting."""

from __future__ import annotations

import torch

from examples.paper.lib.lpips import lpips
from examples.paper.table3.problem import FloatArray
from examples.paper.table3.settings import PAPER_SCALES, Setting
from loi_core import LOIObjective
from loi_core.objectives import MSSSIM, GaussianPyramid, Objective, PixelL2
from loi_torch.rgbxy import RGBXY

__all__ = ["objective"]

MATCHING_INTERVAL = 6  # evaluations of a view between two matchings


def objective(setting: Setting, target: FloatArray) -> Objective:
    """Return the objective of a setting, for one view."""
    target_image = torch.as_tensor(target, dtype=torch.float32)
    if setting.method == "loi":
        scales = PAPER_SCALES if setting.name == "published" else None
        return LOIObjective(target_image, scales, accuracy="balanced")
    if setting.method in ("rgbxy", "rgbxy_finetune"):
        return RGBXY(target_image, grid=setting.grid, interval=MATCHING_INTERVAL)
    if setting.method == "gaussian_pyramid":
        return GaussianPyramid(target_image)
    if setting.method == "ms_ssim":
        return MSSSIM(target_image)
    return PixelL2(target_image) if setting.method == "pixel_l2" else lpips(target_image, "alex")

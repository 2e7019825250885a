"""`loi` in kornia's conventions: losses of images (B, C, H, W), a registration's loss, cameras and poses."""

# ruff: noqa: E402 - kornia is missing where there is only a folder of its name
from loi_core.support.installed import import_library

import_library("kornia")

from loi_torch.kornia.losses import LOILoss, loi_loss
from loi_torch.kornia.registration import RegistrationLoss

__all__ = ["LOILoss", "RegistrationLoss", "loi_loss"]

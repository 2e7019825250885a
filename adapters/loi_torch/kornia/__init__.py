"""`loi` in kornia's conventions: losses of images (B, C, H, W), a registration's loss, cameras and poses."""

from loi_torch.kornia.losses import LOILoss, loi_loss
from loi_torch.kornia.registration import RegistrationLoss

__all__ = ["LOILoss", "RegistrationLoss", "loi_loss"]

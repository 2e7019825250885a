"""`loi` for PyTorch: the loss as a module and as a function, a baseline that needs torch, and renderers."""

from loi_torch.loss import LOILoss, loi_loss
from loi_torch.lpips import LPIPS

__all__ = ["LPIPS", "LOILoss", "loi_loss"]

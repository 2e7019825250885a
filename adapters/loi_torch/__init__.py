"""`loi` for PyTorch: the loss as a module and as a function, a baseline that needs torch, optimisers and renderers."""

from loi_torch.loss import LOILoss, loi_loss
from loi_torch.lpips import LPIPS
from loi_torch.optimisers import TorchOptimiser

__all__ = ["LPIPS", "LOILoss", "TorchOptimiser", "loi_loss"]

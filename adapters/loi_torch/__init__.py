"""`loi` for PyTorch: the loss as a module and as a function, and renderers."""

from loi_torch.loss import LOILoss, loi_loss

__all__ = ["LOILoss", "loi_loss"]

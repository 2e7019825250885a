"""`loi` for PyTorch: the loss as a module and a function, objectives from torch distances, optimisers, renderers."""

from loi_torch.loss import LOILoss, loi_loss
from loi_torch.objective import TorchObjective
from loi_torch.optimisers import TorchOptimiser

__all__ = ["LOILoss", "TorchObjective", "TorchOptimiser", "loi_loss"]

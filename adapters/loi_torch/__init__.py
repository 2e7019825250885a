"""`loi` for PyTorch: the loss as a module and a function, objectives from torch distances, optimisers, renderers."""

# ruff: noqa: E402 - torch is missing where there is only a folder of its name
from loi_core.support.installed import import_library

import_library("torch")

from loi_core.method.dispatch import register_backend
from loi_torch.features import FeatureDistance
from loi_torch.loss import LOILoss, loi_loss
from loi_torch.objective import TorchObjective
from loi_torch.optimisers import TorchOptimiser
from loi_torch.triton_backend.backend import TRITON, executor, supports

__all__ = ["FeatureDistance", "LOILoss", "TorchObjective", "TorchOptimiser", "loi_loss"]

register_backend(supports, TRITON)


def diagnose() -> list[tuple[str, str]]:
    """Return what ``loi doctor`` says about torch: topics with details."""
    return [("torch on a GPU", executor())]

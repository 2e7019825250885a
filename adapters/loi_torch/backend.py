"""The loss on torch as ``loi tradeoff`` measures it: through autograd, on a GPU if there is one."""

from __future__ import annotations

import torch

from loi_core import ScaleSpace
from loi_core.backends import Evaluate, Host
from loi_torch.loss import LOILoss

__all__ = ["Torch"]


class Torch:
    """A :class:`loi_core.backends.Backend`."""

    dtypes = ("float32", "float64")

    def device(self) -> str:
        """The first CUDA device, or the processor."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def prepare(self, image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float, dtype: str) -> Evaluate:
        """See :class:`loi_core.backends.Backend`."""
        device = self.device()
        loss = LOILoss(torch.as_tensor(reference.astype(dtype), device=device), scales, accuracy)
        given = torch.as_tensor(image.astype(dtype), device=device).requires_grad_()

        def evaluate() -> tuple[float, Host]:
            value = loss(given)
            (gradient,) = torch.autograd.grad(value, given)
            return float(value.detach()), gradient.cpu().numpy()  # copying from a GPU waits until it is done

        return evaluate

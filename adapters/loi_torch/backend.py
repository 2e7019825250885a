"""The loss on torch as ``loi tradeoff`` measures it: through autograd, on a GPU if there is one."""

from __future__ import annotations

import warnings

import torch

from loi_core import ScaleSpace
from loi_core.arrays import to_numpy
from loi_core.backends import Evaluate, Host
from loi_core.nonfinite import NanPolicy
from loi_torch.loss import LOILoss

__all__ = ["Torch"]


class Torch:
    """A :class:`loi_core.backends.Backend`."""

    dtypes = ("float32", "float64")
    half_dtypes = ("float16", "bfloat16")
    compiled = False

    def device(self) -> str:
        """The first CUDA device, or the processor."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def asarray(self, host: Host) -> torch.Tensor:
        """A tensor on the same memory, or on a GPU."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that memory is read-only, which the loss never writes to
            return torch.as_tensor(host, device=self.device())

    def prepare(
        self,
        image: Host,
        reference: Host,
        scales: ScaleSpace,
        accuracy: str | float,
        dtype: str,
        nan_policy: NanPolicy = "raise",
    ) -> Evaluate:
        """See :class:`loi_core.backends.Backend`."""
        host = "float32" if dtype in self.half_dtypes else dtype  # NumPy has no bfloat16
        wanted, given = (
            torch.as_tensor(each.astype(host), device=self.device()).to(getattr(torch, dtype))
            for each in (reference, image)
        )
        loss = LOILoss(wanted, scales, accuracy, nan_policy=nan_policy)
        given.requires_grad_()

        def evaluate() -> tuple[float, Host]:
            value = loss(given)
            (gradient,) = torch.autograd.grad(value, given)
            return float(value.detach()), to_numpy(gradient)  # copying from a GPU waits until it is done

        return evaluate

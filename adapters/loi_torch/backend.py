"""The loss on torch for ``loi tradeoff``: through autograd, on a GPU if available."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator

import torch

from loi_core.plugins.measurement_backends import BFLOAT16_PRODUCTS, Evaluate, Request
from loi_core.support.arrays import Host, to_numpy
from loi_torch.loss import LOILoss

__all__ = ["Torch"]


class Torch:
    """A :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""

    half_dtypes = ("float16", "bfloat16")
    compiled = False

    @property
    def dtypes(self) -> tuple[str, ...]:
        """float32, float64, and bfloat16 products where torch uses them."""
        return ("float32", "float64", *([BFLOAT16_PRODUCTS] if _rounds_products(self.device()) else []))

    def device(self) -> str:
        """Return the first CUDA device, or the processor."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def asarray(self, host: Host) -> torch.Tensor:
        """Return a tensor on the same memory, or on a GPU."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about read-only memory; the loss never writes to it
            return torch.as_tensor(host, device=self.device())

    def prepare(self, request: Request) -> Evaluate:
        """See :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""
        products = "medium" if request.dtype == BFLOAT16_PRODUCTS else "highest"
        dtype = "float32" if request.dtype == BFLOAT16_PRODUCTS else request.dtype
        host = "float32" if dtype in self.half_dtypes else dtype  # NumPy has no bfloat16
        reference, image = (
            torch.as_tensor(array.astype(host), device=self.device()).to(getattr(torch, dtype))
            for array in (request.reference, request.image)
        )
        loss = LOILoss(request.scales, request.accuracy, nan_policy=request.nan_policy)
        image.requires_grad_()

        def evaluate() -> tuple[float, Host]:
            with _precision_of_products(products):
                value = loss(image, reference)
                (gradient,) = torch.autograd.grad(value, image)
            return float(value.detach()), to_numpy(gradient)  # copying from a GPU waits until it is done

        return evaluate


def _rounds_products(device: str) -> bool:
    """Return whether torch rounds batched products when allowed to: on GPUs and few processors."""
    fine = torch.full((4, 64, 64), 1.0 + 2.0**-12, device=device)
    with _precision_of_products("medium"):
        product = torch.eye(64, device=device) @ fine
    return not torch.equal(product, fine)


@contextlib.contextmanager
def _precision_of_products(precision: str) -> Iterator[None]:
    """Set the process-wide precision of products, and restore it."""
    previous = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(previous)

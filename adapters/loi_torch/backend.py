"""The loss on torch as ``loi tradeoff`` measures it: through autograd, on a GPU if there is one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch

from loi_core import ScaleSpace
from loi_core.backends import BFLOAT16_PRODUCTS, Evaluate, Host
from loi_torch.loss import LOILoss

__all__ = ["Torch"]


class Torch:
    """A :class:`loi_core.backends.Backend`."""

    @property
    def dtypes(self) -> tuple[str, ...]:
        """Float32 and float64; products in bfloat16 only where torch makes use of the permission."""
        return ("float32", "float64", *([BFLOAT16_PRODUCTS] if _rounds_products(self.device()) else []))

    def device(self) -> str:
        """The first CUDA device, or the processor."""
        return "cuda" if torch.cuda.is_available() else "cpu"

    def prepare(self, image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float, dtype: str) -> Evaluate:
        """See :class:`loi_core.backends.Backend`."""
        device = self.device()
        products = "medium" if dtype == BFLOAT16_PRODUCTS else "highest"
        dtype = "float32" if dtype == BFLOAT16_PRODUCTS else dtype
        loss = LOILoss(torch.as_tensor(reference.astype(dtype), device=device), scales, accuracy)
        given = torch.as_tensor(image.astype(dtype), device=device).requires_grad_()

        def evaluate() -> tuple[float, Host]:
            with _precision_of_products(products):
                value = loss(given)
                (gradient,) = torch.autograd.grad(value, given)
            return float(value.detach()), gradient.cpu().numpy()  # copying from a GPU waits until it is done

        return evaluate


def _rounds_products(device: str) -> bool:
    """Whether batches of products, as blurs are, are rounded when they may be: on GPUs, and on few processors."""
    fine = torch.full((4, 64, 64), 1.0 + 2.0**-12, device=device)
    with _precision_of_products("medium"):
        product = torch.eye(64, device=device) @ fine
    return not torch.equal(product, fine)


@contextlib.contextmanager
def _precision_of_products(precision: str) -> Iterator[None]:
    """Set torch's own switch, which holds for the whole process, and set it back."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)

"""What ``loi tradeoff`` measures: one array library that evaluates the loss and its gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol, TypeAlias

import numpy as np

from loi_core.objectives import LOIObjective
from loi_core.scales import ScaleSpace

__all__ = ["BFLOAT16_PRODUCTS", "Backend", "Evaluate", "Host", "NumPy"]

Host: TypeAlias = np.ndarray[Any, Any]

Evaluate: TypeAlias = Callable[[], tuple[float, Host]]
"""Computes the value, and the gradient as NumPy, shape (H, W, C); returns when both are there."""

BFLOAT16_PRODUCTS: Final = "bfloat16 products"
"""Arrays of float32 whose matrix products a framework may round to bfloat16, or to TF32, told so by its own switch."""


class Backend(Protocol):
    """An array library and how its users call the loss."""

    @property
    def dtypes(self) -> tuple[str, ...]:
        """Names of the dtypes that it computes in, or BFLOAT16_PRODUCTS; the usual one of its users first."""

    def device(self) -> str:
        """Where it computes: "cpu", or another name."""

    def prepare(self, image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float, dtype: str) -> Evaluate:
        """The loss of one image against one reference, both NumPy, shape (H, W, C), ready to be evaluated."""


class NumPy:
    """The core itself."""

    dtypes = ("float32", "float64")

    def device(self) -> str:
        """NumPy knows the processor only."""
        return "cpu"

    def prepare(self, image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float, dtype: str) -> Evaluate:
        """See :class:`Backend`."""
        objective = LOIObjective(reference.astype(dtype), scales, accuracy)
        given = image.astype(dtype)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(given)
            return float(value), gradient

        return evaluate

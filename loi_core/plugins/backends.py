"""What ``loi tradeoff`` and ``loi doctor --stability`` measure: one array library that evaluates the loss."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol, TypeAlias

import numpy as np

from loi_core.method.scales import ScaleSpace
from loi_core.objectives import LOIObjective
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array

__all__ = ["BFLOAT16_PRODUCTS", "Backend", "Evaluate", "Host", "NumPy"]

Host: TypeAlias = np.ndarray[Any, Any]

Evaluate: TypeAlias = Callable[[], tuple[float, Host]]
"""Computes the value, and the gradient as NumPy, of the image's shape; returns when both are there."""

BFLOAT16_PRODUCTS: Final = "bfloat16 products"
"""Arrays of float32 whose matrix products a framework may round to bfloat16, or to TF32, told so by its own switch."""


class Backend(Protocol):
    """An array library and how its users call the loss."""

    @property
    def dtypes(self) -> tuple[str, ...]:
        """Names of the dtypes that it computes in, or BFLOAT16_PRODUCTS; the usual one of its users first."""

    @property
    def half_dtypes(self) -> tuple[str, ...]:
        """Names of the 16-bit dtypes that images may have; it compares those in float32."""

    @property
    def compiled(self) -> bool:
        """Whether it is compiled before it sees pixels, and so gives NaN where others raise for bad ones."""

    def device(self) -> str:
        """Where it computes: "cpu", or another name."""

    def asarray(self, host: Host) -> Array:
        """`host` as an array of the library: the same dtype, and where it can be, the same memory.

        Raises
        ------
        TypeError, ValueError
            If the library has no such arrays.
        """

    def prepare(
        self,
        image: Host,
        reference: Host,
        scales: ScaleSpace,
        accuracy: str | float,
        dtype: str,
        nan_policy: NanPolicy = "raise",
    ) -> Evaluate:
        """The loss of an image against a reference, both NumPy, shape (*batch, H, W, C), ready to be evaluated."""


class NumPy:
    """The core itself."""

    dtypes = ("float32", "float64")
    half_dtypes = ("float16",)
    compiled = False

    def device(self) -> str:
        """NumPy knows the processor only."""
        return "cpu"

    def asarray(self, host: Host) -> Array:
        """`host` itself."""
        return host

    def prepare(
        self,
        image: Host,
        reference: Host,
        scales: ScaleSpace,
        accuracy: str | float,
        dtype: str,
        nan_policy: NanPolicy = "raise",
    ) -> Evaluate:
        """See :class:`Backend`."""
        objective = LOIObjective(reference.astype(dtype), scales, accuracy, nan_policy=nan_policy)
        given = image.astype(dtype)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(given)
            return float(value), gradient

        return evaluate

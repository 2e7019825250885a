"""What ``loi tradeoff`` and ``loi doctor --stability`` measure: one array library that evaluates the loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

from loi_core.method.scales import ScaleSpace
from loi_core.objectives import LOIObjective
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array, Host

__all__ = ["BFLOAT16_PRODUCTS", "Evaluate", "MeasurementBackend", "NumPy", "Request"]

Evaluate: TypeAlias = Callable[[], tuple[float, Host]]
"""Computes the value, and the gradient as NumPy, of the image's shape; returns when both are there."""

BFLOAT16_PRODUCTS: Final = "bfloat16 products"
"""Arrays of float32 whose matrix products a framework may round to bfloat16, or to TF32, told so by its own switch."""


@dataclass(frozen=True)
class Request:
    """A loss that is to be evaluated.

    Attributes
    ----------
    image, reference : array, shape (*batch, H, W, C)
        Both NumPy.
    scales : ScaleSpace
        The scales to compare.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.
    dtype : str
        One of the backend's.
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.
    """

    image: Host
    reference: Host
    scales: ScaleSpace
    accuracy: str | float
    dtype: str
    nan_policy: NanPolicy = "raise"


class MeasurementBackend(Protocol):
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

    def prepare(self, request: Request) -> Evaluate:
        """The loss that is asked for, ready to be evaluated."""


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

    def prepare(self, request: Request) -> Evaluate:
        """See :class:`MeasurementBackend`."""
        reference, given = (each.astype(request.dtype) for each in (request.reference, request.image))
        objective = LOIObjective(reference, request.scales, request.accuracy, nan_policy=request.nan_policy)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(given)
            return float(value), gradient

        return evaluate

"""Measurement backends: array libraries whose evaluation ``loi tradeoff`` and ``loi doctor --stability`` measure."""

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
"""Returns the value, and the gradient with the shape of the image as a NumPy array, when both are computed."""

BFLOAT16_PRODUCTS: Final = "bfloat16 products"
"""float32 arrays with matrix products in bfloat16 or TF32, which a switch of the framework allows."""


@dataclass(frozen=True)
class Request:
    """A requested evaluation of the loss.

    Attributes
    ----------
    image, reference : array, shape (*batch, H, W, C)
        NumPy arrays.
    scales : ScaleSpace
        The compared scales.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.
    dtype : str
        One of the backend's dtypes.
    nan_policy : {"raise", "mask"}
        Treatment of pixels that are not finite.
    """

    image: Host
    reference: Host
    scales: ScaleSpace
    accuracy: str | float
    dtype: str
    nan_policy: NanPolicy = "raise"


class MeasurementBackend(Protocol):
    """An array library, with the loss as its users call it."""

    @property
    def dtypes(self) -> tuple[str, ...]:
        """Names of the backend's dtypes, the default first, and perhaps BFLOAT16_PRODUCTS."""

    @property
    def half_dtypes(self) -> tuple[str, ...]:
        """Names of the 16-bit dtypes of images, which are compared in float32."""

    @property
    def compiled(self) -> bool:
        """Whether the backend traces images without values; non-finite pixels then give NaN instead of an error."""

    def device(self) -> str:
        """Return the name of its device, such as "cpu"."""

    def asarray(self, host: Host) -> Array:
        """Return `host` as an array of the library with the same dtype, without a copy if possible.

        Raises
        ------
        TypeError, ValueError
            If the library has no such arrays.
        """

    def prepare(self, request: Request) -> Evaluate:
        """Return the function that evaluates the requested loss."""


class NumPy:
    """Measurement backend for NumPy."""

    dtypes = ("float32", "float64")
    half_dtypes = ("float16",)
    compiled = False

    def device(self) -> str:
        """Return "cpu"."""
        return "cpu"

    def asarray(self, host: Host) -> Array:
        """Return `host`."""
        return host

    def prepare(self, request: Request) -> Evaluate:
        """See :class:`MeasurementBackend`."""
        reference, image = (array.astype(request.dtype) for array in (request.reference, request.image))
        objective = LOIObjective(reference, request.scales, request.accuracy, nan_policy=request.nan_policy)

        def evaluate() -> tuple[float, Host]:
            value, gradient = objective.value_and_grad(image)
            return float(value), gradient

        return evaluate

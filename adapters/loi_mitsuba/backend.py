"""The measurement backend of Mitsuba, for ``loi tradeoff`` and ``loi doctor --stability``."""

from __future__ import annotations

from typing import Any, NoReturn

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core.plugins.measurement_backends import Evaluate, Request
from loi_core.support.arrays import Host, to_numpy
from loi_mitsuba.loss import loi_loss

__all__ = ["Mitsuba"]


class Mitsuba:
    """Measurement backend for Mitsuba in the current variant, or in ``llvm_ad_rgb`` if none is set."""

    dtypes = ("float32",)
    half_dtypes: tuple[str, ...] = ()
    compiled = False

    def device(self) -> str:
        """Return "cuda" in CUDA variants, else "cpu"."""
        return "cuda" if str(self._variant()).startswith("cuda") else "cpu"

    def asarray(self, host: Host) -> NoReturn:
        """Raise TypeError: Dr.Jit's tensors always have contiguous memory, whatever the layout of `host`."""
        msg = f"Dr.Jit's tensors are contiguous copies, which lose the memory layout of a {type(host).__name__}"
        raise TypeError(msg)

    def prepare(self, request: Request) -> Evaluate:
        """Build the loss; see :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""
        self._variant()
        tensor, target = (
            mi.TensorXf(np.ascontiguousarray(array, request.dtype)) for array in (request.image, request.reference)
        )

        def evaluate() -> tuple[float, Host]:
            dr.enable_grad(tensor)
            dr.set_grad(tensor, 0.0)
            value = loi_loss(tensor, target, request.scales, request.accuracy, nan_policy=request.nan_policy)
            dr.backward(value)
            return float(value[0]), to_numpy(dr.grad(tensor).numpy())

        return evaluate

    @staticmethod
    def _variant() -> Any:
        if mi.variant() is None:
            mi.set_variant("llvm_ad_rgb")
        return mi.variant()

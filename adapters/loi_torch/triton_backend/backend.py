"""When Triton compares images: float32 tensors on NVIDIA GPUs, if its kernels compile there."""

from __future__ import annotations

import functools
import importlib.util
import os
import warnings
from dataclasses import dataclass, replace
from typing import Any, Final

import torch
from torch import Tensor

from loi_core.method.array_comparison import ArrayComparison
from loi_core.method.comparison import Comparison, ComparisonResult
from loi_core.method.compiled import SWITCH
from loi_core.method.dispatch import Backend, OwnLibrary
from loi_core.method.plan import Plan
from loi_core.method.scales import ScaleSpace
from loi_core.support.arrays import is_recorded, is_torch_array
from loi_core.support.wording import described

__all__ = ["TRITON", "TritonWarning", "executor", "supports"]

MIN_CAPABILITY: Final = (8, 0)  # of the GPUs that Triton's kernels are compiled for in the tests


FAILED_DEVICES: Final[set[str]] = set()
"""Devices on which a kernel has failed where whole arrays have not."""


class TritonWarning(RuntimeWarning):
    """Triton cannot compare images on this GPU, so whole-array operations of torch are used, which are slower."""


class _Triton(OwnLibrary):
    """Kernels written in Triton."""

    def comparison(
        self, scales: ScaleSpace, plan: Plan, reference: Tensor, weights: Tensor | None = None
    ) -> Comparison:
        from loi_torch.triton_backend.comparison import TritonComparison  # imports Triton

        try:
            return _FallbackComparison(TritonComparison.of(scales, plan, reference, weights), scales, plan, reference)
        except Exception as error:  # noqa: BLE001  # as below
            return _by_arrays(error, scales, plan, reference, weights)


@dataclass(frozen=True)
class _FallbackComparison:
    """A comparison by kernels, or by whole arrays if a kernel cannot be compiled or launched on this GPU."""

    kernels: Comparison
    scales: ScaleSpace
    plan: Plan
    reference: Tensor
    weights: Tensor | None = None

    def compare(self, compressed: Tensor, *, gradient: bool) -> ComparisonResult:
        """See :class:`loi_core.method.comparison.Comparison`."""
        try:
            return self.kernels.compare(compressed, gradient=gradient)
        except Exception as error:  # noqa: BLE001  # of Triton, of the compilers that it runs, or of the driver
            by_arrays = _by_arrays(error, self.scales, self.plan, self.reference, self.weights)
            result = by_arrays.compare(compressed, gradient=gradient)
            FAILED_DEVICES.add(str(self.reference.device))  # compiling again would take seconds of every step
            return result

    def with_weights(self, weights: Tensor) -> Comparison:
        """See :class:`loi_core.method.comparison.Comparison`."""
        return replace(self, kernels=self.kernels.with_weights(weights), weights=weights)


def _by_arrays(
    error: Exception, scales: ScaleSpace, plan: Plan, reference: Tensor, weights: Tensor | None
) -> Comparison:
    """Return the comparison by whole arrays, which raises errors of its own if the cause is not Triton."""
    if isinstance(error, torch.cuda.OutOfMemoryError):  # whole arrays need more
        raise error
    _warn(f"its kernels fail ({described(error)})")
    return ArrayComparison.of(scales, plan, reference, weights)


TRITON: Final[Backend] = _Triton()


def supports(image: Any) -> bool:
    """Return whether Triton compares an image.

    A GPU or dtype that it does not take is named in one warning; ``LOI_COMPILED=0`` disables it without one.
    """
    if not is_torch_array(image) or image.device.type != "cuda" or os.environ.get(SWITCH) == "0" or is_recorded(image):
        return False
    if str(image.device) in FAILED_DEVICES:
        return False
    problem = f"it compares float32, not {image.dtype}" if image.dtype != torch.float32 else _problem(str(image.device))
    if problem:
        _warn(problem)
    return not problem


def executor() -> str:
    """Return what compares float32 images on the first CUDA device, and why."""
    if not torch.cuda.is_available():
        return "torch finds no CUDA device"
    if os.environ.get(SWITCH) == "0":
        return f"whole-array operations, because of {SWITCH}=0"
    problem = _problem("cuda:0")
    return f"whole-array operations: {problem}" if problem else "kernels in Triton, for float32 images"


@functools.cache
def _problem(device: str) -> str:
    """Return why Triton cannot compare float32 images on a CUDA device; empty if it can."""
    if torch.version.hip is not None:
        return "it is used on NVIDIA GPUs only"
    if importlib.util.find_spec("triton") is None:
        return "it is not installed"
    capability = torch.cuda.get_device_capability(device)
    if capability < MIN_CAPABILITY:
        return f"{device} has the compute capability {capability[0]}.{capability[1]}, less than 8.0"
    try:
        from loi_torch.triton_backend import kernels
        from loi_torch.triton_backend.launching import Launcher

        run = Launcher(torch.device(device))
        plane = run.empty(1)
        run.launch(kernels.difference_stack, (1, 1), plane, plane, plane, 1, 1, 0, 1, *[1.0] * 5, BLOCK=16)
    except Exception as error:  # noqa: BLE001  # of Triton, of the C compiler that it runs, or of the driver
        return f"its kernels do not compile ({described(error)})"
    return ""


@functools.cache
def _warn(problem: str) -> None:
    msg = (
        f"loi's Triton kernels do not compare these images ({problem}), so whole-array operations of torch do, which "
        f"are slower; {SWITCH}=0 silences this"
    )
    warnings.warn(msg, TritonWarning, stacklevel=2)

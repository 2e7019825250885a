"""Launches of kernels and allocations, or on torch's "meta" device a record of them, which needs no GPU and no data."""

from __future__ import annotations

import contextlib
import weakref
from dataclasses import dataclass, field
from typing import Any, Final

import torch
from torch import Tensor

__all__ = ["EXPONENTIAL", "Launch", "Launcher", "Recorder"]

EXPONENTIAL: Final = 16.0  # multiplications and additions that a GPU does in the time of an exponential

OPTIONS: Final = {"enable_fp_fusion": True}  # the default, which depends on the version of Triton, may warn
MAX_GRID_AXIS: Final = 65535  # of the second and third axis of a grid


@dataclass(frozen=True)
class Launch:
    """A launch of a kernel.

    Attributes
    ----------
    kernel : triton.JITFunction or str
        The kernel, or the name of an operation of torch.
    arguments : tuple
        Numbers, and the dtypes of tensors.
    constants : dict
        The kernel's constexpr parameters.
    options : dict
        Triton's, such as the number of warps.
    bytes : int
        Memory that the launch reads and writes, each tensor once.
    operations : float
        Multiplications and additions of its products; an exponential counts as EXPONENTIAL.
    """

    kernel: Any
    arguments: tuple[Any, ...]
    constants: dict[str, Any]
    options: dict[str, Any]
    bytes: int
    operations: float


@dataclass(frozen=True)
class Launcher:
    """Allocates tensors on a device, and launches kernels there."""

    device: torch.device

    def empty(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        """Return a tensor of undefined values."""
        return torch.empty(shape, dtype=dtype, device=self.device)

    def launch(
        self,
        kernel: Any,
        grid: tuple[int, ...],
        *arguments: Any,
        operations: float = 0.0,
        warps: int = 4,
        **constants: Any,
    ) -> None:
        """Launch a kernel of `warps` warps; `operations` are as in :class:`Launch`."""
        del operations
        with torch.cuda.device(self.device) if self.device.type == "cuda" else contextlib.nullcontext():
            kernel[grid](*arguments, **constants, num_warps=warps, **OPTIONS)

    def count(self, operation: str, *tensors: Tensor) -> None:
        """Note that an operation of torch launches a kernel of its own."""


@dataclass(frozen=True)
class Recorder(Launcher):
    """Records launches, and the memory of the tensors that are alive at once."""

    device: torch.device = field(default_factory=lambda: torch.device("meta"))
    launches: list[Launch] = field(default_factory=list)
    _bytes: dict[str, int] = field(default_factory=lambda: {"now": 0, "peak": 0})

    @property
    def peak(self) -> int:
        """The largest number of bytes that were alive at once."""
        return self._bytes["peak"]

    def empty(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        """See :class:`Launcher`."""
        tensor = super().empty(*shape, dtype=dtype)
        size = tensor.numel() * tensor.element_size()
        self._bytes["now"] += size
        self._bytes["peak"] = max(self._bytes["now"], self._bytes["peak"])
        weakref.finalize(tensor, self._free, size)
        return tensor

    def launch(
        self,
        kernel: Any,
        grid: tuple[int, ...],
        *arguments: Any,
        operations: float = 0.0,
        warps: int = 4,
        **constants: Any,
    ) -> None:
        """See :class:`Launcher`."""
        if max(grid[1:], default=1) > MAX_GRID_AXIS:
            msg = f"the grid {grid} is too large for CUDA"
            raise ValueError(msg)
        described = tuple(value.dtype if isinstance(value, Tensor) else value for value in arguments)
        # A weight that is not there is passed as another argument, so count each tensor once.
        tensors = {id(value): value for value in arguments if isinstance(value, Tensor)}
        self.launches.append(
            Launch(kernel, described, constants, {"num_warps": warps}, _bytes(tensors.values()), operations)
        )

    def count(self, operation: str, *tensors: Tensor) -> None:
        """See :class:`Launcher`."""
        self.launches.append(Launch(operation, (), {}, {}, _bytes(tensors), 0.0))

    def _free(self, size: int) -> None:
        self._bytes["now"] -= size


def _bytes(tensors: Any) -> int:
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)

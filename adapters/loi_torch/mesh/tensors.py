"""Validation and normalisation of tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.wording import shown

__all__ = ["accelerator_of", "background_tensor", "finite_tensor", "unit"]


def finite_tensor(name: str, value: Any, shape: tuple[int | None, ...] | None = None) -> Tensor:
    """Return `value` as a finite float64 tensor on the processor; a tensor keeps its graph.

    Meshes are drawn on the processor, so tensors of all devices may meet; a gradient returns to the tensor's device.
    A ParameterError with `name` is raised if it is not numeric, not finite or of another shape; None allows any length.
    """
    try:
        tensor = value if isinstance(value, Tensor) else torch.as_tensor(_real_array(value))
        tensor = tensor.to("cpu", torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        msg = f"`{name}` must be numbers, got {shown(value)}"
        raise ParameterError(msg) from error
    if shape is not None and not (
        tensor.ndim == len(shape)
        and all(expected in (None, actual) for expected, actual in zip(shape, tensor.shape, strict=True))
    ):
        allowed = ", ".join("any" if length is None else str(length) for length in shape)
        msg = f"`{name}` must have shape ({allowed}), got {tuple(tensor.shape)}"
        raise ParameterError(msg)
    is_bad = ~torch.isfinite(tensor.detach())
    if bool(is_bad.any()):
        first = tuple(int(index) for index in torch.nonzero(is_bad)[0])
        msg = f"`{name}` must be finite, got {int(is_bad.sum())} that are not, the first at {first}"
        raise ParameterError(msg)
    return tensor


def accelerator_of(*values: Any) -> torch.device | None:
    """Return the device of the first tensor that is not on the processor; None if there is none."""
    devices = (value.device for value in values if isinstance(value, Tensor))
    return next((device for device in devices if device.type != "cpu"), None)


def _real_array(value: Any) -> np.ndarray[Any, Any]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        msg = f"{array.dtype} is not a real dtype"
        raise TypeError(msg)
    return array.astype(np.float64)


def background_tensor(background: Any, height: int, width: int) -> Tensor:
    """Return a background as a number, a colour, shape (3,), or an image, shape (height, width, 3)."""
    colours = finite_tensor("background", background)
    if tuple(colours.shape) not in ((), (3,), (height, width, 3)):
        msg = f"`background` must have shape (3,) or ({height}, {width}, 3), got {tuple(colours.shape)}"
        raise ParameterError(msg)
    return colours


def unit(vector: Tensor) -> Tensor:
    """Normalise vectors along the last axis; 0 stays 0."""
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    result: Tensor = vector / torch.where(length > 0.0, length, torch.ones_like(length))
    return result

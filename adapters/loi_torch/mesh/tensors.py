"""Numbers for torch."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.wording import shown

__all__ = ["colours_behind", "tensor_of", "unit"]


def tensor_of(name: str, value: Any, shape: tuple[int | None, ...] | None = None) -> Tensor:
    """`value` as finite float64 numbers of a shape, None being any number of rows; a tensor keeps its graph."""
    try:
        tensor = value if isinstance(value, Tensor) else torch.as_tensor(_real(value))
        tensor = tensor.to(torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        msg = f"`{name}` must be numbers, got {shown(value)}"
        raise ParameterError(msg) from error
    if shape is not None and not (
        tensor.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, tensor.shape, strict=True))
    ):
        wanted = ", ".join("any" if one is None else str(one) for one in shape)
        msg = f"`{name}` must have shape ({wanted}), got {tuple(tensor.shape)}"
        raise ParameterError(msg)
    bad = ~torch.isfinite(tensor.detach())
    if bool(bad.any()):
        first = tuple(int(one) for one in torch.nonzero(bad)[0])
        msg = f"`{name}` must be finite, got {int(bad.sum())} that are not, the first at {first}"
        raise ParameterError(msg)
    return tensor


def _real(value: Any) -> np.ndarray[Any, Any]:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        msg = f"{array.dtype} is no real number"
        raise TypeError(msg)
    return array.astype(np.float64)


def colours_behind(background: Any, height: int, width: int) -> Tensor:
    """A background of an image of this size: one number, one colour, or the colours of all pixels."""
    colours = tensor_of("background", background)
    if tuple(colours.shape) not in ((), (3,), (height, width, 3)):
        msg = f"`background` must have shape (3,) or ({height}, {width}, 3), got {tuple(colours.shape)}"
        raise ParameterError(msg)
    return colours


def unit(vector: Tensor) -> Tensor:
    """Vectors of length 1 along the last axis; 0 stays 0."""
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    result: Tensor = vector / torch.where(length > 0.0, length, torch.ones_like(length))
    return result

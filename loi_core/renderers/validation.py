"""Checks of the values that a scene hands to a NumPy renderer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from loi_core.errors import ParameterError
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["FloatArray", "check_dtype", "check_floats", "check_image", "check_parameters", "check_size"]

FloatArray: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]


def check_floats(name: str, value: object, shape: tuple[int | None, ...]) -> FloatArray:
    """`value` as a new float64 array of `shape`, in which None stands for any length."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)
    if given.dtype.kind not in "fiu":
        msg = f"`{name}` must be numbers of shape {_spell(shape)}, got {shown(value)}"
        raise ParameterError(msg)
    array = given.astype(np.float64)
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        msg = f"`{name}` must have shape {_spell(shape)}, got {array.shape}"
        raise ParameterError(msg)
    if not np.all(np.isfinite(array)):
        msg = f"`{name}` must be finite, got {int((~np.isfinite(array)).sum())} values that are not"
        raise ParameterError(msg)
    return array


def check_dtype(value: object) -> np.dtype[Any]:
    """The dtype of that name, float64 or float32."""
    if not isinstance(value, str) or value not in ("float64", "float32"):
        msg = f"`dtype` must be 'float64' or 'float32', got {shown(value)}"
        raise ParameterError(msg)
    return np.dtype(value)


def check_size(name: str, value: object) -> int:
    """`value` as an int, once it is known to be a number of pixels."""
    size = whole_number(value)
    if size is None or size < 1:
        msg = f"`{name}` must be a whole number of pixels, 1 or more, got {shown(value)}"
        raise ParameterError(msg)
    return size


def check_image(name: str, value: object, channels: tuple[int, ...]) -> FloatArray:
    """`value` as a new float64 image (H, W, C) whose channel count is one of `channels`."""
    image = check_floats(name, value, (None, None, None))
    if image.shape[2] not in channels or image.size == 0:
        msg = f"`{name}` must be (H, W, {' or '.join(map(str, channels))}) and not empty, got {image.shape}"
        raise ParameterError(msg)
    return image


def check_parameters(params: Mapping[str, object], like: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """`params` as float64 arrays, once they are known to be all of `like`'s names with the same shapes."""
    if set(params) != set(like):
        msg = f"`params` must have exactly the names {sorted(like)}, got {sorted(params)}"
        raise ParameterError(msg)
    return {name: check_floats(name, params[name], like[name].shape) for name in like}


def _spell(shape: tuple[int | None, ...]) -> str:
    sizes = ["n" if size is None else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"

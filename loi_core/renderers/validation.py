"""Validation of the arguments of NumPy renderers."""

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
    """Return `value` as a new float64 array of `shape`, where None allows any length."""
    try:
        values = np.asarray(value)
    except ValueError:  # rows of different lengths
        values = np.asarray(None)
    if values.dtype.kind not in "fiu":
        msg = f"`{name}` must be numbers of shape {_format_shape(shape)}, got {shown(value)}"
        raise ParameterError(msg)
    array = values.astype(np.float64)
    if array.ndim != len(shape) or any(
        expected not in (None, actual) for expected, actual in zip(shape, array.shape, strict=True)
    ):
        msg = f"`{name}` must have shape {_format_shape(shape)}, got {array.shape}"
        raise ParameterError(msg)
    if not np.all(np.isfinite(array)):
        msg = f"`{name}` must be finite, got {int((~np.isfinite(array)).sum())} values that are not"
        raise ParameterError(msg)
    return array


def check_dtype(value: object) -> np.dtype[Any]:
    """Return the dtype called `value`, "float64" or "float32"."""
    if not isinstance(value, str) or value not in ("float64", "float32"):
        msg = f"`dtype` must be 'float64' or 'float32', got {shown(value)}"
        raise ParameterError(msg)
    return np.dtype(value)


def check_size(name: str, value: object) -> int:
    """Return `value` as a positive number of pixels."""
    size = whole_number(value)
    if size is None or size < 1:
        msg = f"`{name}` must be a whole number of pixels, 1 or more, got {shown(value)}"
        raise ParameterError(msg)
    return size


def check_image(name: str, value: object, channels: tuple[int, ...]) -> FloatArray:
    """Return `value` as a new float64 image (H, W, C) whose channel count is one of `channels`."""
    image = check_floats(name, value, (None, None, None))
    if image.shape[2] not in channels or image.size == 0:
        msg = f"`{name}` must be (H, W, {' or '.join(map(str, channels))}) and not empty, got {image.shape}"
        raise ParameterError(msg)
    return image


def check_parameters(params: Mapping[str, object], like: Mapping[str, np.ndarray[Any, Any]]) -> dict[str, FloatArray]:
    """Return `params` as float64 arrays; raise :class:`ParameterError` if names or shapes differ from `like`."""
    if set(params) != set(like):
        msg = f"`params` must have exactly the names {sorted(like)}, got {sorted(params)}"
        raise ParameterError(msg)
    return {name: check_floats(name, params[name], like[name].shape) for name in like}


def _format_shape(shape: tuple[int | None, ...]) -> str:
    sizes = ["n" if size is None else str(size) for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"

"""Helpers for code that runs on every array library."""

from __future__ import annotations

import math
import sys
from typing import Any, TypeAlias

import array_api_compat
import numpy as np
from array_api_compat import array_namespace, is_array_api_obj, is_jax_array, is_numpy_array, is_torch_array

from loi_core.errors import ImageTypeError

__all__ = [
    "Array",
    "Host",
    "Namespace",
    "arrays_equal",
    "as_floating",
    "copied",
    "detached",
    "device",
    "epsilon",
    "from_numpy",
    "held",
    "is_array_api_obj",
    "is_numpy_array",
    "is_read_by_numpy",
    "is_recorded",
    "is_torch_array",
    "is_traced",
    "library_name",
    "matrix_product",
    "namespace",
    "narrowed",
    "norm",
    "outlives_its_context",
    "runs_eagerly_on_host",
    "sum_of_all",
    "to_numpy",
    "values_may_decide",
    "widened",
]

Array: TypeAlias = Any
"""An array of any library of the array API standard: NumPy, torch, JAX, array_api_strict, CuPy, ..."""

Host: TypeAlias = np.ndarray[Any, Any]
"""A NumPy array."""

Namespace: TypeAlias = Any
"""The functions of the array API standard for one library."""


def namespace(array: Array) -> Namespace:
    """Return the array API namespace of `array`."""
    return array_namespace(array)


def device(array: Array) -> Any:
    """Return the device of `array` for new arrays of any shape; an array on several devices gives all of them."""
    placement = array_api_compat.device(array)
    if not is_jax_array(array) or not hasattr(placement, "spec"):
        return placement
    return type(placement)(placement.mesh, type(placement.spec)())  # the partition of `array` may not fit other shapes


def library_name(array: Array) -> str:
    """Return the name of the library of `array`, for messages and cache keys."""
    return str(namespace(array).__name__).removeprefix("array_api_compat.")


def epsilon(array: Array) -> float:
    """Return the machine epsilon of the dtype of `array`."""
    return float(namespace(array).finfo(array.dtype).eps)


def from_numpy(values: np.ndarray[Any, Any], like: Array) -> Array:
    """Return `values` as an array of the library, dtype and device of `like`."""
    xp = namespace(like)
    if is_torch_array(like) and not values.flags.writeable:
        values = values.copy()  # torch warns of memory that must not be written to
    return xp.asarray(values, dtype=like.dtype, device=device(like))


def copied(array: Array) -> Array:
    """Return a copy of `array`."""
    return namespace(array).asarray(array, copy=True)


def widened(array: Array) -> Array:
    """Return `array`, as float32 if its dtype has fewer bits: those can hold an image, but not sums over it."""
    xp = namespace(array)
    return array if xp.finfo(array.dtype).bits >= 32 else xp.astype(array, xp.float32)


def narrowed(result: Array, like: Array) -> Array:
    """Return a result that was computed from ``widened(like)`` in the dtype of `like`."""
    return result if result.dtype == like.dtype else namespace(like).astype(result, like.dtype)


def outlives_its_context(array: Array) -> bool:
    """Return whether a new array may be used later; not in torch's inference mode or while JAX traces."""
    if is_torch_array(array):
        return not array.is_inference()
    return not is_traced(array)


def is_traced(array: Array) -> bool:
    """Return whether JAX traces `array`: it has no values yet, and is useless once the trace has ended."""
    return type(array).__name__.endswith("Tracer")


def runs_eagerly_on_host(array: Array) -> bool:
    """Return whether operations run one by one on the processor, so that small arrays stay in its caches."""
    if is_jax_array(array):
        return False
    return is_numpy_array(array) or "cpu" in str(device(array)).lower()


def is_read_by_numpy(array: Array) -> bool:
    """Return whether NumPy can read `array` in place: it has values, in the memory of the processor."""
    if is_jax_array(array):
        return not is_traced(array) and [device.platform for device in array.devices()] == ["cpu"]
    return is_numpy_array(array) or (is_torch_array(array) and array.device.type == "cpu")


def is_recorded(array: Array) -> bool:
    """Return whether torch records operations on `array` to differentiate them, or propagates a tangent."""
    if not is_torch_array(array):
        return False
    forward = sys.modules["torch"].autograd.forward_ad  # torch is imported, since `array` is its tensor
    return bool(array.requires_grad) or forward.unpack_dual(array).tangent is not None


def values_may_decide(array: Array) -> bool:
    """Return whether code may branch on the values of `array`: it has values, and no framework differentiates.

    A branch that does not change a result may still change its derivative.
    """
    return runs_eagerly_on_host(array) and not is_recorded(array)


def sum_of_all(array: Array) -> Array:
    """Return the sum of all entries, as a 0-d array, with an error that does not grow with their number.

    Most libraries add in pairs, or in many sums side by side. XLA, which runs JAX, may cut each axis into pieces of 32
    and add all entries of such a block one after another: 32**4 entries for four axes, with 1e5 roundings, 1 % in
    float32. For JAX one axis is averaged at a time instead: 32 entries of one size, one after another, are off by 8
    roundings at most. Plain sums along one axis at a time would not help, since XLA merges several sums into one.
    """
    if not is_jax_array(array):
        return namespace(array).sum(array)
    mean = array
    while mean.ndim:
        mean = namespace(array).mean(mean, axis=-1)
    return mean * array.size


def matrix_product(left: Array, right: Array) -> Array:
    """Return ``left @ right`` in the precision of their dtype, which JAX reduces by default on GPUs and TPUs."""
    xp = namespace(left)
    return xp.matmul(left, right, precision="highest") if is_jax_array(left) else xp.matmul(left, right)


def norm(array: Array) -> float:
    """Return the 2-norm of an array as a float.

    ``numpy.linalg.norm`` calls BLAS, for whose threads a forked process waits forever; a plain sum does not.
    """
    return math.sqrt(float(np.sum(np.square(to_numpy(array), dtype=np.float64))))


def to_numpy(array: Array) -> np.ndarray[Any, Any]:
    """Return `array` as NumPy on the host, without a copy where dtype, layout and :func:`is_read_by_numpy` allow."""
    if is_torch_array(array):
        # torch refuses to export tensors that record gradients, lie on another device or have the negative bit.
        host: np.ndarray[Any, Any] = (array.float() if "bfloat16" in str(array.dtype) else array).numpy(force=True)
        return host
    host = np.asarray(array)
    # NumPy has no bfloat16; JAX's extension type can be neither written to a file nor computed with safely.
    return host.astype(np.float32) if "bfloat16" in str(host.dtype) else host


def detached(array: Array) -> Array:
    """Return `array` without torch's record of its gradient; the same numbers."""
    return array.detach() if is_torch_array(array) else array


def held(array: Array) -> Array:
    """Return `array` as a constant to the automatic differentiation of its library; the same numbers."""
    if is_traced(array):
        return sys.modules["jax"].lax.stop_gradient(array)  # JAX is imported, since it traces `array`
    return detached(array)


def as_floating(name: str, array: Array) -> Array:
    """Return `array` after checking that it is a real floating-point array.

    Raises
    ------
    ImageTypeError
        If it is not an array, if it is an integer, boolean, complex, object or masked array, or if it is a tensor
        that is sparse or has no values.
    """
    if isinstance(array, np.ma.MaskedArray):
        msg = f"`{name}` is a NumPy masked array; fill it (`.filled(nan)`) and pass nan_policy='mask'"
        raise ImageTypeError(msg)
    if not is_array_api_obj(array):
        msg = f"`{name}` must be an array of an array API library, got {type(array).__name__}"
        raise ImageTypeError(msg)
    if is_torch_array(array):
        _check_has_values(name, array)
    if is_numpy_array(array):
        floating = array.dtype.kind == "f"  # the compat test refuses dtypes that NumPy alone has (object, str)
    else:
        floating = namespace(array).isdtype(array.dtype, "real floating")
    if floating and is_numpy_array(array) and not array.dtype.isnative:
        msg = f"`{name}` must be in this machine's byte order, got dtype {array.dtype}; use array.astype(float)"
        raise ImageTypeError(msg)
    if not floating:
        fix = "divide 8-bit images by 255" if "int" in str(array.dtype) else "convert it first"
        msg = f"`{name}` must hold real floating-point values, got dtype {array.dtype}; {fix}"
        raise ImageTypeError(msg)
    return array


def _check_has_values(name: str, tensor: Array) -> None:
    """Raise :class:`ImageTypeError` for a sparse or meta tensor; torch's own errors do not name the argument."""
    if str(tensor.layout) != "torch.strided":
        msg = f"`{name}` must be a dense tensor, got the layout {tensor.layout}; use `.to_dense()`"
        raise ImageTypeError(msg)
    if tensor.device.type == "meta":
        msg = f"`{name}` must hold values, got a tensor on the device 'meta', which stores none; use another device"
        raise ImageTypeError(msg)


def arrays_equal(first: Host, second: Host) -> bool:
    """Return whether two arrays are equal, NaN equal to NaN."""
    return first.shape == second.shape and bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))

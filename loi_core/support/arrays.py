"""The few helpers that make one piece of code run on every array library."""

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
    "as_floating",
    "copied",
    "detached",
    "device",
    "epsilon",
    "from_numpy",
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
    "same",
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
    """The array API namespace of `array`."""
    return array_namespace(array)


def device(array: Array) -> Any:
    """Where `array` lies, to make others of any shape there: if on several devices, then on each of them."""
    found = array_api_compat.device(array)
    if not is_jax_array(array) or not hasattr(found, "spec"):
        return found
    return type(found)(found.mesh, type(found.spec)())  # that of `array` may cut axes that others do not have


def library_name(array: Array) -> str:
    """Name of the library that `array` belongs to, for messages and cache keys."""
    return str(namespace(array).__name__).removeprefix("array_api_compat.")


def epsilon(array: Array) -> float:
    """Machine epsilon of the dtype of `array`."""
    return float(namespace(array).finfo(array.dtype).eps)


def from_numpy(values: np.ndarray[Any, Any], like: Array) -> Array:
    """`values` as an array of the library, dtype and device of `like`."""
    xp = namespace(like)
    return xp.asarray(values, dtype=like.dtype, device=device(like))


def copied(array: Array) -> Array:
    """The same numbers, in an array of their own."""
    return namespace(array).asarray(array, copy=True)


def widened(array: Array) -> Array:
    """`array` itself, or in float32 if its dtype has fewer bits: those can hold an image, but not sums over one."""
    xp = namespace(array)
    return array if xp.finfo(array.dtype).bits >= 32 else xp.astype(array, xp.float32)


def narrowed(result: Array, like: Array) -> Array:
    """What was computed from ``widened(like)``, in the dtype of `like`."""
    return result if result.dtype == like.dtype else namespace(like).astype(result, like.dtype)


def outlives_its_context(array: Array) -> bool:
    """Whether `array`, just made, may be used later: not so in torch's inference mode, nor while JAX traces."""
    if is_torch_array(array):
        return not array.is_inference()
    return not is_traced(array)


def is_traced(array: Array) -> bool:
    """Whether JAX traces `array`: its values are not known yet, and it is of no use once the trace has ended."""
    return type(array).__name__.endswith("Tracer")


def runs_eagerly_on_host(array: Array) -> bool:
    """Whether operations on arrays like this run one by one, on the processor: then small arrays stay in its caches."""
    if is_jax_array(array):
        return False
    return is_numpy_array(array) or "cpu" in str(device(array)).lower()


def is_read_by_numpy(array: Array) -> bool:
    """Whether NumPy can read `array` where it is: its values are at hand, in the memory of the processor."""
    if is_jax_array(array):
        return not is_traced(array) and [each.platform for each in array.devices()] == ["cpu"]
    return is_numpy_array(array) or (is_torch_array(array) and array.device.type == "cpu")


def is_recorded(array: Array) -> bool:
    """Whether a framework records what is computed of `array`, to differentiate it, or carries a derivative along."""
    if not is_torch_array(array):
        return False
    forward = sys.modules["torch"].autograd.forward_ad  # which has been imported: `array` is of it
    return bool(array.requires_grad) or forward.unpack_dual(array).tangent is not None


def values_may_decide(array: Array) -> bool:
    """Whether what is computed of `array` may depend on its values: they are at hand, and no framework differentiates.

    Where a value does not change the result, its derivative may still do.
    """
    return runs_eagerly_on_host(array) and not is_recorded(array)


def sum_of_all(array: Array) -> Array:
    """The sum of all entries, as a 0-d array, with an error that does not grow with their number.

    Most libraries add in pairs, or in many sums side by side. XLA, which runs JAX, may cut each axis into pieces of 32
    and add all entries of such a block one after another: 32**4 of them for four axes, which costs 1e5 roundings, 1 %
    in float32. So there one axis is averaged at a time: 32 entries of one size, one after another, are off by 8
    roundings at the most. Plain sums along one axis at a time would not do, as XLA makes one sum of several.
    """
    if not is_jax_array(array):
        return namespace(array).sum(array)
    mean = array
    while mean.ndim:
        mean = namespace(array).mean(mean, axis=-1)
    return mean * array.size


def matrix_product(left: Array, right: Array) -> Array:
    """``left @ right`` in the precision of their dtype, which JAX does not keep by default on GPUs and TPUs."""
    xp = namespace(left)
    return xp.matmul(left, right, precision="highest") if is_jax_array(left) else xp.matmul(left, right)


def norm(array: Array) -> float:
    """The 2-norm of an array on the host.

    A plain sum: what NumPy has for it calls BLAS, whose threads a forked process waits for in vain.
    """
    return math.sqrt(float(np.sum(np.square(to_numpy(array), dtype=np.float64))))


def to_numpy(array: Array) -> np.ndarray[Any, Any]:
    """`array` as NumPy, on the host; the same memory if :func:`is_read_by_numpy`, where dtype and layout allow."""
    if is_torch_array(array):
        # torch alone refuses to export what records gradients, lies on another device or is held as a negative.
        host: np.ndarray[Any, Any] = (array.float() if "bfloat16" in str(array.dtype) else array).numpy(force=True)
        return host
    host = np.asarray(array)
    # NumPy has no bfloat16; what JAX gives for it can be neither written to a file nor computed with safely.
    return host.astype(np.float32) if "bfloat16" in str(host.dtype) else host


def detached(array: Array) -> Array:
    """`array` cut off from what a framework records for its own gradients; the same numbers."""
    return array.detach() if is_torch_array(array) else array


def as_floating(name: str, array: Array) -> Array:
    """`array` itself, once it is known to be a real floating-point array.

    Raises
    ------
    ImageTypeError
        For anything that is not an array, for integer, boolean, complex, object and masked arrays, and for tensors
        that are sparse or have no values.
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
    """Raise :class:`ImageTypeError` unless a tensor holds each of its values: torch's own errors do not name it."""
    if str(tensor.layout) != "torch.strided":
        msg = f"`{name}` must be a dense tensor, got the layout {tensor.layout}; use `.to_dense()`"
        raise ImageTypeError(msg)
    if tensor.device.type == "meta":
        msg = f"`{name}` must hold values, got a tensor on the device 'meta', which has none; make it on another"
        raise ImageTypeError(msg)


def same(first: Host, second: Host) -> bool:
    """Equal to the bit, NaN equal to NaN."""
    return first.shape == second.shape and bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))

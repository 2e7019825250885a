"""An evaluation of the loss as a JAX primitive, lowered by platform.

On a processor the compiled program calls back into the core, which compares the image in loops compiled by Numba. On
other platforms, and in programs for several devices or platforms or for export, where callbacks are impossible, the
primitive lowers to whole-array operations.

``jax.pure_callback`` is unsuitable: it converts its arguments to JAX arrays on a thread without the context of
``jax.enable_x64``, so that float64 loses half its bits; and a JAX thread that waits for a JAX array may deadlock
(https://github.com/jax-ml/jax/issues/25861). This callback handles NumPy arrays only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from loi_core.support.arrays import Host, from_numpy, is_read_by_numpy

__all__ = ["Evaluation", "Host", "evaluate"]

Results: TypeAlias = Sequence[Any]


class Evaluation(Protocol):
    """The loss of an image on both backends: the value, shape (), and on request the gradient, shaped as the image."""

    def on_numba(self, image: Host, target: Host, weights: Host | None = None, *, gradient: bool) -> tuple[Host, ...]:
        """Evaluate NumPy arrays; pixels that are not finite and negative weights give NaN instead of an error."""

    def on_arrays(
        self, image: jax.Array, target: jax.Array, weights: jax.Array | None = None, *, gradient: bool
    ) -> tuple[jax.Array, ...]:
        """Evaluate in traceable operations."""


def evaluate(
    evaluation: Evaluation, image: jax.Array, target: jax.Array, weights: jax.Array | None, *, gradient: bool
) -> list[jax.Array]:
    """Return the results of `evaluation` for float32 or float64 arrays, under any of JAX's transformations."""
    operands = (image, target) if weights is None else (image, target, weights)
    results: list[jax.Array] = _loss.bind(*operands, evaluation=evaluation, gradient=gradient, mapped=0)
    return results


_loss: Any = Primitive("loi_loss")
_loss.multiple_results = True


def _abstract(image: Any, *_constants: Any, gradient: bool, mapped: int, **_: Any) -> list[ShapedArray]:
    """Return shapes and dtypes; ``vmap`` added the first `mapped` axes of all operands."""
    value = ShapedArray(image.shape[:mapped], image.dtype)
    return [value, ShapedArray(image.shape, image.dtype)] if gradient else [value]


def _batch(
    operands: Sequence[jax.Array], axes: Sequence[int | None], *, mapped: int, **settings: Any
) -> tuple[Results, tuple[int, ...]]:
    """Evaluate a batch under ``vmap`` in one call."""
    (size, *_) = (operand.shape[axis] for operand, axis in zip(operands, axes, strict=True) if axis is not None)
    fronted = (
        jnp.broadcast_to(operand, (size, *operand.shape)) if axis is None else jnp.moveaxis(operand, axis, 0)
        for operand, axis in zip(operands, axes, strict=True)
    )
    results = _loss.bind(*fronted, mapped=mapped + 1, **settings)
    return results, (0,) * len(results)


def _on_arrays(*operands: jax.Array, evaluation: Evaluation, gradient: bool, mapped: int) -> Results:
    compare: Callable[..., Results] = partial(evaluation.on_arrays, gradient=gradient)
    for _ in range(mapped):
        compare = jax.vmap(compare)
    return compare(*operands)


def _on_numba(*operands: Host, evaluation: Evaluation, gradient: bool, mapped: int) -> list[Host]:
    image = operands[0]
    results = [np.empty(image.shape[: image.ndim if slope else mapped], image.dtype) for slope in range(1 + gradient)]
    for index in np.ndindex(image.shape[:mapped]):
        parts = evaluation.on_numba(*(operand[index] for operand in operands), gradient=gradient)
        for result, part in zip(results, parts, strict=True):
            result[index] = part
    return results


def _run(*operands: jax.Array, **settings: Any) -> Results:
    """Evaluate outside of ``jit``."""
    arrays = [jnp.asarray(operand) for operand in operands]
    if not all(map(is_read_by_numpy, arrays)):
        return _on_arrays(*arrays, **settings)
    return [from_numpy(result, arrays[0]) for result in _on_numba(*map(np.asarray, arrays), **settings)]


def _differentiate(operands: Sequence[jax.Array], tangents: Sequence[Any], **settings: Any) -> tuple[Results, Results]:
    """Differentiate the gradient for second derivatives, through whole-array operations."""
    # The tangents of target and weights, which are constants, are symbolic zeros.
    primals, numbers = tuple(operands), tuple(map(ad.instantiate_zeros, tangents))
    results: tuple[Results, Results] = jax.jvp(partial(_on_arrays, **settings), primals, numbers)
    return results


_lower_arrays: Any = mlir.lower_fun(_on_arrays, multiple_results=True)


def _lower_for_processor(ctx: Any, *operands: Any, **settings: Any) -> Results:
    module = ctx.module_context
    single = len(module.platforms) == 1 and getattr(module.axis_context, "num_devices", 0) == 1
    if not single or module.lowering_parameters.for_export:
        lowered: Results = _lower_arrays(ctx, *operands, **settings)
        return lowered
    outputs = ctx.avals_out
    double = outputs[0].dtype == np.float64
    # JAX converts results to the dtypes of the calling thread, which may lack 64 bits. Integers pass unchanged.
    passed = [ShapedArray((*aval.shape, 2), np.dtype(np.int32)) for aval in outputs] if double else outputs

    def call(*arrays: Host) -> list[Host]:
        results = _on_numba(*arrays, **settings)
        return [result[..., None].view(np.int32) for result in results] if double else results

    results, _, _ = mlir.emit_python_callback(
        ctx.replace(avals_out=passed), call, None, operands, ctx.avals_in, passed, has_side_effect=False
    )
    return _lower_doubles(ctx.replace(avals_in=passed), *results) if double else results


def _doubles(*bits: jax.Array) -> list[jax.Array]:
    with jax.enable_x64():  # whatever the setting while the program is lowered
        return [jax.lax.bitcast_convert_type(pair, np.float64) for pair in bits]


_lower_doubles: Any = mlir.lower_fun(_doubles, multiple_results=True)

_loss.def_abstract_eval(_abstract)
_loss.def_impl(_run)
batching.primitive_batchers[_loss] = _batch
ad.primitive_jvps[_loss] = _differentiate
mlir.register_lowering(_loss, _lower_arrays)
mlir.register_lowering(_loss, _lower_for_processor, platform="cpu")

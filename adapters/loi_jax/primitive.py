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

from loi_core.support.arrays import Host, device, from_numpy, is_read_by_numpy

__all__ = ["Evaluation", "Host", "evaluate"]

Results: TypeAlias = Sequence[Any]


class Evaluation(Protocol):
    """The loss of an image on both backends: the value, shape (), and on request the gradient, shaped as the image."""

    def on_numba(self, image: Host, *, gradient: bool) -> tuple[Host, ...]:
        """Evaluate NumPy arrays; non-finite images give NaN instead of an error."""

    def on_arrays(self, image: jax.Array, *, gradient: bool, placement: Any = None) -> tuple[jax.Array, ...]:
        """Evaluate in traceable operations, with the reference on the devices `placement`, JAX's default if None."""


def evaluate(evaluation: Evaluation, image: jax.Array, *, gradient: bool) -> list[jax.Array]:
    """Return the results of `evaluation` for `image`, float32 or float64, under any of JAX's transformations."""
    results: list[jax.Array] = _loss.bind(image, evaluation=evaluation, gradient=gradient, mapped=0)
    return results


_loss: Any = Primitive("loi_loss")
_loss.multiple_results = True


def _abstract(image: Any, *, gradient: bool, mapped: int, **_: Any) -> list[ShapedArray]:
    """Return shapes and dtypes; ``vmap`` added the first `mapped` axes of the image."""
    value = ShapedArray(image.shape[:mapped], image.dtype)
    return [value, ShapedArray(image.shape, image.dtype)] if gradient else [value]


def _batch(
    images: tuple[jax.Array], axes: tuple[int], *, mapped: int, **settings: Any
) -> tuple[Results, tuple[int, ...]]:
    """Evaluate a batch under ``vmap`` in one call."""
    results = _loss.bind(jnp.moveaxis(images[0], axes[0], 0), mapped=mapped + 1, **settings)
    return results, (0,) * len(results)


def _on_arrays(
    image: jax.Array, *, evaluation: Evaluation, gradient: bool, mapped: int, placement: Any = None
) -> Results:
    compare: Callable[[jax.Array], Results] = partial(evaluation.on_arrays, gradient=gradient, placement=placement)
    for _ in range(mapped):
        compare = jax.vmap(compare)
    return compare(image)


def _on_numba(image: Host, *, evaluation: Evaluation, gradient: bool, mapped: int) -> list[Host]:
    results = [np.empty(image.shape[: image.ndim if slope else mapped], image.dtype) for slope in range(1 + gradient)]
    for index in np.ndindex(image.shape[:mapped]):
        for result, part in zip(results, evaluation.on_numba(image[index], gradient=gradient), strict=True):
            result[index] = part
    return results


def _run(image: jax.Array, **settings: Any) -> Results:
    """Evaluate outside of ``jit``."""
    image = jnp.asarray(image)
    if not is_read_by_numpy(image):
        return _on_arrays(image, placement=device(image), **settings)
    return [from_numpy(result, image) for result in _on_numba(np.asarray(image), **settings)]


def _differentiate(images: tuple[jax.Array], tangents: tuple[jax.Array], **settings: Any) -> tuple[Results, Results]:
    """Differentiate the gradient for second derivatives, through whole-array operations."""
    results: tuple[Results, Results] = jax.jvp(partial(_on_arrays, **settings), images, tangents)
    return results


_lower_arrays: Any = mlir.lower_fun(_on_arrays, multiple_results=True)


def _lower_for_processor(ctx: Any, image: Any, **settings: Any) -> Results:
    module = ctx.module_context
    single = len(module.platforms) == 1 and getattr(module.axis_context, "num_devices", 0) == 1
    if not single or module.lowering_parameters.for_export:
        lowered: Results = _lower_arrays(ctx, image, **settings)
        return lowered
    outputs = ctx.avals_out
    double = outputs[0].dtype == np.float64
    # JAX converts results to the dtypes of the calling thread, which may lack 64 bits. Integers pass unchanged.
    passed = [ShapedArray((*aval.shape, 2), np.dtype(np.int32)) for aval in outputs] if double else outputs

    def call(*images: Host) -> list[Host]:
        results = _on_numba(images[0], **settings)
        return [result[..., None].view(np.int32) for result in results] if double else results

    results, _, _ = mlir.emit_python_callback(
        ctx.replace(avals_out=passed), call, None, [image], ctx.avals_in, passed, has_side_effect=False
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

"""One evaluation of the loss as a primitive of JAX: how it is computed is decided where it is compiled, by platform.

On the processor the compiled program calls back, and the core compares the image with the loops that Numba compiled.
On other platforms it is operations on whole arrays, and so it is on the processor if the program is to run on several
devices or platforms, or to be exported: a call back can do neither.

``jax.pure_callback`` will not do: it makes JAX arrays of what it hands over, on a thread that knows nothing of
``jax.enable_x64`` as a context, so that float64 loses half its bits; and a thread of JAX's that waits for a JAX array
may wait for ever (https://github.com/jax-ml/jax/issues/25861). Here what is called sees NumPy only.
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
    """The loss of one image, in both ways: the value, shape (), and if asked for the gradient, of the image's shape."""

    def by_loops(self, image: Host, *, gradient: bool) -> tuple[Host, ...]:
        """From and to NumPy arrays, without errors for what the image holds."""

    def by_arrays(self, image: jax.Array, *, gradient: bool, where: Any = None) -> tuple[jax.Array, ...]:
        """As what JAX can trace; with what is prepared on these devices, if not on the one that JAX chooses."""


def evaluate(evaluation: Evaluation, image: jax.Array, *, gradient: bool) -> list[jax.Array]:
    """What `evaluation` gives for `image`, float32 or float64, under any of JAX's transformations."""
    found: list[jax.Array] = _loss.bind(image, evaluation=evaluation, gradient=gradient, mapped=0)
    return found


_loss: Any = Primitive("loi_loss")
_loss.multiple_results = True


def _abstract(image: Any, *, gradient: bool, mapped: int, **_: Any) -> list[ShapedArray]:
    """Shapes and dtypes; the first `mapped` axes of the image are those of ``vmap``."""
    value = ShapedArray(image.shape[:mapped], image.dtype)
    return [value, ShapedArray(image.shape, image.dtype)] if gradient else [value]


def _batch(
    images: tuple[jax.Array], axes: tuple[int], *, mapped: int, **settings: Any
) -> tuple[Results, tuple[int, ...]]:
    """Under ``vmap``: one call for all images."""
    results = _loss.bind(jnp.moveaxis(images[0], axes[0], 0), mapped=mapped + 1, **settings)
    return results, (0,) * len(results)


def _by_arrays(image: jax.Array, *, evaluation: Evaluation, gradient: bool, mapped: int, where: Any = None) -> Results:
    compare: Callable[[jax.Array], Results] = partial(evaluation.by_arrays, gradient=gradient, where=where)
    for _ in range(mapped):
        compare = jax.vmap(compare)
    return compare(image)


def _by_loops(image: Host, *, evaluation: Evaluation, gradient: bool, mapped: int) -> list[Host]:
    results = [np.empty(image.shape[: image.ndim if slope else mapped], image.dtype) for slope in range(1 + gradient)]
    for index in np.ndindex(image.shape[:mapped]):
        for result, found in zip(results, evaluation.by_loops(image[index], gradient=gradient), strict=True):
            result[index] = found
    return results


def _run(image: jax.Array, **settings: Any) -> Results:
    """Outside of ``jit``."""
    image = jnp.asarray(image)
    if not is_read_by_numpy(image):
        return _by_arrays(image, where=device(image), **settings)
    return [from_numpy(result, image) for result in _by_loops(np.asarray(image), **settings)]


def _differentiate(images: tuple[jax.Array], tangents: tuple[jax.Array], **settings: Any) -> tuple[Results, Results]:
    """Of the gradient, for second derivatives: operations on whole arrays have them."""
    found: tuple[Results, Results] = jax.jvp(partial(_by_arrays, **settings), images, tangents)
    return found


_lower_arrays: Any = mlir.lower_fun(_by_arrays, multiple_results=True)


def _lower_for_processor(ctx: Any, image: Any, **settings: Any) -> Results:
    module = ctx.module_context
    single = len(module.platforms) == 1 and getattr(module.axis_context, "num_devices", 0) == 1
    if not single or module.lowering_parameters.for_export:
        lowered: Results = _lower_arrays(ctx, image, **settings)
        return lowered
    wanted = ctx.avals_out
    double = wanted[0].dtype == np.float64
    # JAX converts what comes back to the dtypes of the calling thread, which may lack 64 bits. Integers pass.
    given = [ShapedArray((*each.shape, 2), np.dtype(np.int32)) for each in wanted] if double else wanted

    def call(*images: Host) -> list[Host]:
        results = _by_loops(images[0], **settings)
        return [result[..., None].view(np.int32) for result in results] if double else results

    results, _, _ = mlir.emit_python_callback(
        ctx.replace(avals_out=given), call, None, [image], ctx.avals_in, given, has_side_effect=False
    )
    return _lower_doubles(ctx.replace(avals_in=given), *results) if double else results


def _doubles(*bits: jax.Array) -> list[jax.Array]:
    with jax.enable_x64():  # the program has them, so whatever is set while it is lowered
        return [jax.lax.bitcast_convert_type(each, np.float64) for each in bits]


_lower_doubles: Any = mlir.lower_fun(_doubles, multiple_results=True)

_loss.def_abstract_eval(_abstract)
_loss.def_impl(_run)
batching.primitive_batchers[_loss] = _batch
ad.primitive_jvps[_loss] = _differentiate
mlir.register_lowering(_loss, _lower_arrays)
mlir.register_lowering(_loss, _lower_for_processor, platform="cpu")

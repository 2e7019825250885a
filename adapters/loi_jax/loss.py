"""The loss under JAX's transformations: the core computes the value and the gradient that ``custom_vjp`` returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from loi_core import LogTone, ScaleSpace
from loi_core.errors import DerivativeError, ImageError
from loi_core.method.dispatch import numba_supports
from loi_core.objectives.loss import LossSettings, Reduction, reduced
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.target import image_and_weights
from loi_core.support.arrays import as_floating, device, held, is_traced
from loi_core.support.keywords import suggest_keywords
from loi_jax.primitive import Host, evaluate
from loi_jax.scan_comparison import SCAN

__all__ = ["loi_loss"]

HALF_DTYPES: Final = (jnp.float16, jnp.bfloat16)


@suggest_keywords
def loi_loss(
    image: Any,
    target: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
    reduction: Reduction = "mean",
) -> jax.Array:
    """Return the locally orderless image loss of an image and a target.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
    target : array or Target, shape (*batch, H, W, C)
        The image to match; batch axes of length 1, and batch axes that it lacks, are repeated. Its gradient is 0.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for colour differences.
    accuracy, channel_axis, nan_policy, tone, exposure, colours
        See :class:`loi_core.LOIObjective`.
    weights : array, shape (H, W) or the image's shape without channels, optional
        Weight of each pixel, such as the mask of the pixels that a warp covers. Their gradient is 0.
    reduction : {"mean", "sum", "none"}
        The mean or the sum over the images of a batch, or one value for each image.

    Returns
    -------
    array, shape (), or the shape of the batch for ``reduction="none"``

    Raises
    ------
    LoiError
        As :func:`loi_core.loi_loss`.

    Notes
    -----
    ``jit``, ``grad`` and ``vmap`` work in any order, over image, target and weights. Traced values cannot raise errors:
    with ``nan_policy="raise"``, value and gradient of a non-finite image or target, or of negative weights, are NaN,
    which ``fit`` and ``jax.debug_nans`` detect. float16 and bfloat16 are compared in float32. Forward mode (``jvp``,
    ``jacfwd``) raises a DerivativeError; under ``jit`` and in the result of ``linearize``, JAX itself raises a
    TypeError.
    """
    settings = LossSettings.of(
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        exposure=exposure,
        colours=colours,
        reduction=reduction,
    )
    target, weights = image_and_weights(target, weights, channel_axis)
    image, target = as_floating("image", jnp.asarray(image)), as_floating("target", jnp.asarray(target))
    settings.layouts(image, target, weights)  # while the caller is on the stack
    # Convert before the custom derivative, so that JAX scales the gradient before rounding it to 16 bits.
    precise = image.astype(jnp.float32) if image.dtype in HALF_DTYPES else image
    target = held(target.astype(precise.dtype))
    weights = None if weights is None else held(jnp.asarray(weights, dtype=precise.dtype))
    try:
        value: jax.Array = reduced(_loss, settings, precise, target, weights, each=jax.vmap)
    except TypeError as error:  # JAX has no specific error type
        if "forward-mode" not in str(error):
            raise
        msg = "loi's loss has no forward mode on JAX; use jax.grad, jax.vjp or jax.jacrev"
        raise DerivativeError(msg) from error
    return value


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _loss(settings: LossSettings, image: jax.Array, target: jax.Array, weights: jax.Array | None) -> jax.Array:
    return _Evaluation(settings).results(image, target, weights, gradient=False)[0]


def _forward(
    settings: LossSettings, image: jax.Array, target: jax.Array, weights: jax.Array | None
) -> tuple[jax.Array, jax.Array]:
    value, slope = _Evaluation(settings).results(image, target, weights, gradient=True)
    return value, slope


def _backward(_: LossSettings, gradient: jax.Array, upstream: jax.Array) -> tuple[jax.Array, None, None]:
    return upstream * gradient, None, None


_loss.defvjp(_forward, _backward)


@dataclass(frozen=True)
class _Evaluation:
    """The core's evaluation for tracers, which can neither raise errors nor fill a cache."""

    settings: LossSettings

    def results(
        self, image: jax.Array, target: jax.Array, weights: jax.Array | None, *, gradient: bool
    ) -> Sequence[jax.Array]:
        """Return the value and, on request, the gradient."""
        if not any(map(is_traced, (image, target, weights))):
            target = jax.device_put(target, device(image))  # JAX's default device may be another
            return self._checked(image, target, weights, gradient=gradient)
        if numba_supports(str(image.dtype)) and jax.sharding.get_abstract_mesh().empty:
            # With a mesh, each of several devices would compare its part.
            return evaluate(self, image, target, weights, gradient=gradient)
        return self.on_arrays(image, target, weights, gradient=gradient)

    def _checked(self, image: Any, target: Any, weights: Any, *, gradient: bool) -> tuple[Any, ...]:
        """Evaluate in the core, on arrays of any library, with its checks."""
        value, slope = self.settings.evaluate(image, target, weights, gradient=gradient)
        return (value,) if slope is None else (value, slope)

    def on_numba(self, image: Host, target: Host, weights: Host | None = None, *, gradient: bool) -> tuple[Host, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        try:
            return self._checked(image, target, weights, gradient=gradient)
        except ImageError:  # a pixel that is not finite, or a negative weight
            nan = np.full_like(image, np.nan)
            return (nan.flat[0], nan) if gradient else (nan.flat[0],)

    def on_arrays(
        self, image: jax.Array, target: jax.Array, weights: jax.Array | None = None, *, gradient: bool
    ) -> tuple[jax.Array, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        value, slope = self.settings.evaluate(image, target, weights, gradient=gradient, has_values=False, backend=SCAN)
        return (value,) if slope is None else (value, slope)

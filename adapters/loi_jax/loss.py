"""The loss under JAX's transformations: the core computes the value and the gradient that ``custom_vjp`` returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.errors import DerivativeError, ImageError, ImageTypeError
from loi_core.method.dispatch import numba_supports
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import as_floating, held, is_traced
from loi_jax.primitive import Host, evaluate

__all__ = ["loi_loss"]

HALF_DTYPES: Final = (jnp.float16, jnp.bfloat16)


def loi_loss(
    reference: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
) -> Callable[[jax.Array], jax.Array]:
    """Return the locally orderless image loss against a reference, as a function of the image.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Image to match; a concrete array of JAX or NumPy, not a tracer.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for colour differences.
    accuracy, channel_axis, nan_policy, tone, weights, exposure, colours
        See :class:`loi_core.LOIObjective`.

    Returns
    -------
    callable
        Maps an image, shape (*batch, H, W, C), to a scalar. It works under ``jit``, ``grad`` and ``vmap`` in any
        order, and is traced once for each shape and dtype. Its keyword `weights`, shape (H, W) or the image's shape
        without channels, brings the weights of that image, such as the mask of the pixels that a warp covers. They
        multiply the weights of the reference and get no gradient.

    Notes
    -----
    Traced values cannot raise errors: under ``jit`` and ``vmap`` with ``nan_policy="raise"``, value and gradient of a
    non-finite image, or of negative `weights`, are NaN, which ``fit`` and ``jax.debug_nans`` detect. float16 and
    bfloat16 are compared in float32. Forward mode (``jvp``, ``jacfwd``) raises a DerivativeError; under ``jit`` and in
    the result of ``linearize``, JAX itself raises a TypeError.
    """
    for name, array in (("reference", reference), ("weights", weights)):
        if is_traced(array):
            msg = f"`{name}` must be concrete, got a tracer; make the loss outside of `jit`, `grad` and `vmap`"
            raise ImageTypeError(msg)
    host = np.asarray(reference)
    if host.dtype.kind == "V" or str(host.dtype) in ("bfloat16", "float16"):
        host = host.astype(np.float32)
    # The objective keeps a NumPy array, which no trace can leak into.
    objective = LOIObjective(
        host,
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        weights=weights,
        exposure=exposure,
        colours=colours,
    )
    return _Loss(objective)


class _Loss:
    """The loss as a function of the image. Pickles and copies are traced again."""

    def __init__(self, objective: LOIObjective) -> None:
        self._objective = objective
        traceable = _Traceable(objective)

        @jax.custom_vjp
        def loss(image: jax.Array, weights: jax.Array | None) -> jax.Array:
            return traceable.value(image, weights)

        def forward(image: jax.Array, weights: jax.Array | None) -> tuple[jax.Array, jax.Array]:
            return traceable.value_and_grad(image, weights)

        def backward(gradient: jax.Array, upstream: jax.Array) -> tuple[jax.Array, None]:
            return upstream * gradient, None

        loss.defvjp(forward, backward)
        self._loss = loss
        self.__name__ = "loi_loss"  # its name in compiled programs

    def __call__(self, image: jax.Array, *, weights: jax.Array | None = None) -> jax.Array:
        """Return the loss of `image`, with weights of its pixels."""
        image = as_floating("image", jnp.asarray(image))
        # Convert before the custom derivative, so that JAX scales the gradient before rounding it to 16 bits.
        precise = image.astype(jnp.float32) if image.dtype in HALF_DTYPES else image
        if weights is not None:
            self._objective.check_shape(image.shape, weights)
            weights = held(jnp.asarray(weights, dtype=precise.dtype))
        try:
            return self._loss(precise, weights)
        except TypeError as error:  # JAX has no specific error type
            if "forward-mode" not in str(error):
                raise
            msg = "loi's loss has no forward mode on JAX; use jax.grad, jax.vjp or jax.jacrev"
            raise DerivativeError(msg) from error

    def __repr__(self) -> str:
        return f"<loi_jax.loi_loss of {self._objective!r}>"

    def __reduce__(self) -> tuple[type[_Loss], tuple[LOIObjective]]:
        return _Loss, (self._objective,)


class _Traceable:
    """The core's evaluation for tracers, which can neither raise errors nor fill a cache."""

    def __init__(self, objective: LOIObjective) -> None:
        self._objective = objective

    def value(self, image: jax.Array, weights: jax.Array | None) -> jax.Array:
        return self._evaluate(image, weights, gradient=False)[0]

    def value_and_grad(self, image: jax.Array, weights: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        value, slope = self._evaluate(image, weights, gradient=True)
        return value, slope

    def _evaluate(self, image: jax.Array, weights: jax.Array | None, *, gradient: bool) -> Sequence[jax.Array]:
        if not is_traced(image) and not is_traced(weights):
            return self._evaluate_checked(image, weights, gradient=gradient)
        if numba_supports(str(image.dtype)) and jax.sharding.get_abstract_mesh().empty:
            # With a mesh, each of several devices would compare its part.
            self._objective.check_shape(image.shape)  # while the caller is on the stack
            return evaluate(self, image, weights, gradient=gradient)
        return self.on_arrays(image, weights, gradient=gradient)

    def _evaluate_checked(self, image: Any, weights: Any, *, gradient: bool) -> tuple[Any, ...]:
        """Evaluate in the core, on arrays of any library, with its checks."""
        if gradient:
            return self._objective.value_and_grad(image, weights=weights)
        return (self._objective.value(image, weights=weights),)

    def on_numba(self, image: Host, weights: Host | None = None, *, gradient: bool) -> tuple[Host, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        try:
            return self._evaluate_checked(image, weights, gradient=gradient)
        except ImageError:  # a pixel that is not finite, or a negative weight
            nan = np.full_like(image, np.nan)
            return (nan.flat[0], nan) if gradient else (nan.flat[0],)

    def on_arrays(
        self, image: jax.Array, weights: jax.Array | None = None, *, gradient: bool, placement: Any = None
    ) -> tuple[jax.Array, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        with jax.ensure_compile_time_eval():  # the prepared reference outlives this trace
            like = jnp.zeros((), dtype=image.dtype, device=placement)
            self._objective.prepare(image.shape, like, weighted=weights is not None)
        value, slope = self._objective.evaluate_unchecked(image, like, weights, gradient=gradient)
        results = (value,) if slope is None else (value, slope)
        conditions = []
        if self._objective.nan_policy == "raise":
            # Blurring spreads NaN, but clipping may remove an infinity.
            conditions.append(jnp.all(jnp.isfinite(self._objective.visible(image, weights))))
        if weights is not None:
            conditions.append(jnp.all(jnp.isfinite(weights) & (weights >= 0.0)))
        for condition in conditions:
            poison = jnp.where(condition, 0.0, jnp.nan).astype(image.dtype)
            results = tuple(result + poison for result in results)
        return results

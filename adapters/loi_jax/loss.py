"""The loss for JAX's transformations: the core computes value and gradient, ``custom_vjp`` hands on the gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.errors import DerivativeError, ImageTypeError, NonFiniteImageError
from loi_core.method.dispatch import numba_supports
from loi_core.pixels.colours import Colours
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import as_floating, is_traced
from loi_jax.primitive import Host, evaluate

__all__ = ["loi_loss"]

REDUCED: Final = (jnp.float16, jnp.bfloat16)


def loi_loss(
    reference: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    colours: Colours = "channels",
) -> Callable[[jax.Array], jax.Array]:
    """The locally orderless image loss against a reference, as a function of the image.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        What the image should look like; JAX or NumPy, concrete, not a tracer.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy, channel_axis, nan_policy, tone, weights, colours
        See :class:`loi_core.LOIObjective`.

    Returns
    -------
    callable
        From an image, shape (*batch, H, W, C), to a scalar. Works under ``jit``, ``grad`` and ``vmap`` in any
        order, and is traced once for each shape and dtype.

    Notes
    -----
    Traced values cannot raise errors: under ``jit`` and ``vmap`` an image that is not finite gives the value NaN and
    a gradient of NaN with ``nan_policy="raise"``, which ``fit`` and ``jax.debug_nans`` catch. float16 and bfloat16
    are compared in float32. Forward mode (``jvp``, ``jacfwd``) raises a DerivativeError; under ``jit``, or in what
    ``linearize`` gives, JAX itself refuses it, by a TypeError.
    """
    for name, given in (("reference", reference), ("weights", weights)):
        if is_traced(given):
            msg = f"`{name}` must be concrete, got a tracer; make the loss outside of `jit`, `grad` and `vmap`"
            raise ImageTypeError(msg)
    host = np.asarray(reference)
    if host.dtype.kind == "V" or str(host.dtype) in ("bfloat16", "float16"):
        host = host.astype(np.float32)
    # Checked here, with the core's messages; what is kept is NumPy, which no trace can leak into.
    objective = LOIObjective(
        host,
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        weights=weights,
        colours=colours,
    )
    return _Loss(objective)


class _Loss:
    """The loss as a function of the image. It can be pickled and copied; a copy is traced anew."""

    def __init__(self, objective: LOIObjective) -> None:
        self._objective = objective
        traceable = _Traceable(objective)

        @jax.custom_vjp
        def loss(image: jax.Array) -> jax.Array:
            return traceable.value(image)

        def forward(image: jax.Array) -> tuple[jax.Array, jax.Array]:
            return traceable.value_and_grad(image)

        def backward(gradient: jax.Array, upstream: jax.Array) -> tuple[jax.Array]:
            return (upstream * gradient,)

        loss.defvjp(forward, backward)
        self._loss = loss
        self.__name__ = "loi_loss"  # what JAX calls it where it is compiled

    def __call__(self, image: jax.Array) -> jax.Array:
        """The loss of `image`."""
        image = as_floating("image", jnp.asarray(image))
        # Out here, so that JAX scales the gradient before it rounds it: what 16 bits flush to 0 no scale brings back.
        precise = image.astype(jnp.float32) if image.dtype in REDUCED else image
        try:
            return self._loss(precise)
        except TypeError as error:  # JAX has no type of its own for it
            if "forward-mode" not in str(error):
                raise
            msg = "loi's loss has no forward mode on JAX; use jax.grad, jax.vjp or jax.jacrev"
            raise DerivativeError(msg) from error

    def __repr__(self) -> str:
        return f"<loi_jax.loi_loss by {self._objective!r}>"

    def __reduce__(self) -> tuple[type[_Loss], tuple[LOIObjective]]:
        return _Loss, (self._objective,)


class _Traceable:
    """The core's evaluation without what a tracer cannot do: raising, and filling a cache."""

    def __init__(self, objective: LOIObjective) -> None:
        self._objective = objective

    def value(self, image: jax.Array) -> jax.Array:
        return self._evaluate(image, gradient=False)[0]

    def value_and_grad(self, image: jax.Array) -> tuple[jax.Array, jax.Array]:
        value, slope = self._evaluate(image, gradient=True)
        return value, slope

    def _evaluate(self, image: jax.Array, *, gradient: bool) -> Sequence[jax.Array]:
        if not isinstance(image, jax.core.Tracer):
            return self._checked(image, gradient=gradient)
        if numba_supports(str(image.dtype)) and jax.sharding.get_abstract_mesh().empty:
            # With a mesh it would be for several devices, each with its part.
            self._objective.check_shape(image.shape)  # where the caller is still to be seen, not where it is compiled
            return evaluate(self, image, gradient=gradient)
        return self.by_arrays(image, gradient=gradient)

    def _checked(self, image: Any, *, gradient: bool) -> tuple[Any, ...]:
        """By the core alone, on arrays of any library."""
        return self._objective.value_and_grad(image) if gradient else (self._objective.value(image),)

    def by_loops(self, image: Host, *, gradient: bool) -> tuple[Host, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        try:
            return self._checked(image, gradient=gradient)
        except NonFiniteImageError:
            nan = np.full_like(image, np.nan)
            return (nan.flat[0], nan) if gradient else (nan.flat[0],)

    def by_arrays(self, image: jax.Array, *, gradient: bool, where: Any = None) -> tuple[jax.Array, ...]:
        """See :class:`loi_jax.primitive.Evaluation`."""
        with jax.ensure_compile_time_eval():  # so that what is prepared is concrete, and outlives this trace
            like = jnp.zeros((), dtype=image.dtype, device=where)
            self._objective.prepare(image.shape, like)
        value, slope = self._objective.evaluate_unchecked(image, like, gradient=gradient)
        results = (value,) if slope is None else (value, slope)
        if self._objective.nan_policy == "raise":
            # Blurring spreads a NaN anyway, but clipping may swallow an infinity.
            poison = jnp.where(jnp.all(jnp.isfinite(self._objective.visible(image))), 0.0, jnp.nan).astype(image.dtype)
            results = tuple(result + poison for result in results)
        return results

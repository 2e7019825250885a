"""The loss on JAX for ``loi tradeoff``: compiled, on JAX's default device."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp

from loi_core.plugins.measurement_backends import Evaluate, Request
from loi_core.support.arrays import Host, to_numpy
from loi_jax.loss import loi_loss

__all__ = ["Jax"]


class Jax:
    """A :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""

    dtypes = ("float32", "float64")
    half_dtypes = ("float16", "bfloat16")
    compiled = True

    def device(self) -> str:
        """Return the name of JAX's default device."""
        return str(jax.default_backend())

    def asarray(self, host: Host) -> jax.Array:
        """Return a copy as a JAX array, in 64 bits only if JAX allows them."""
        return jnp.asarray(host)

    def prepare(self, request: Request) -> Evaluate:
        """See :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""
        loss = partial(loi_loss, scales=request.scales, accuracy=request.accuracy, nan_policy=request.nan_policy)
        value_and_grad = jax.jit(jax.value_and_grad(loss))
        double = request.dtype == "float64"
        with jax.enable_x64(double):
            image, target = (jnp.asarray(array, dtype=request.dtype) for array in (request.image, request.reference))

        def evaluate() -> tuple[float, Host]:
            with jax.enable_x64(double):
                value, gradient = value_and_grad(image, target)
                gradient.block_until_ready()  # computed together with the value
            return float(value), to_numpy(gradient)

        return evaluate

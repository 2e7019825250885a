"""The loss on JAX as ``loi tradeoff`` measures it: compiled, on JAX's default device."""

from __future__ import annotations

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
        """JAX's default device."""
        return str(jax.default_backend())

    def asarray(self, host: Host) -> jax.Array:
        """A copy as a JAX array; of 64 bits only where JAX has them switched on."""
        return jnp.asarray(host)

    def prepare(self, request: Request) -> Evaluate:
        """See :class:`loi_core.plugins.measurement_backends.MeasurementBackend`."""
        wanted = request.reference.astype("float32" if request.dtype in self.half_dtypes else request.dtype)
        loss = loi_loss(wanted, request.scales, request.accuracy, nan_policy=request.nan_policy)
        value_and_grad = jax.jit(jax.value_and_grad(loss))
        double = request.dtype == "float64"
        with jax.enable_x64(double):
            given = jnp.asarray(request.image, dtype=request.dtype)

        def evaluate() -> tuple[float, Host]:
            with jax.enable_x64(double):
                value, gradient = value_and_grad(given)
                gradient.block_until_ready()  # computed together with the value
            return float(value), to_numpy(gradient)

        return evaluate

"""The loss on JAX as ``loi tradeoff`` measures it: compiled, on JAX's default device."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from loi_core import ScaleSpace
from loi_core.backends import Evaluate, Host
from loi_jax.loss import loi_loss

__all__ = ["Jax"]


class Jax:
    """A :class:`loi_core.backends.Backend`."""

    dtypes = ("float32", "float64")

    def device(self) -> str:
        """JAX's default device."""
        return str(jax.default_backend())

    def prepare(self, image: Host, reference: Host, scales: ScaleSpace, accuracy: str | float, dtype: str) -> Evaluate:
        """See :class:`loi_core.backends.Backend`."""
        value_and_grad = jax.jit(jax.value_and_grad(loi_loss(reference.astype(dtype), scales, accuracy)))
        double = dtype == "float64"
        with jax.enable_x64(double):
            given = jnp.asarray(image, dtype=dtype)

        def evaluate() -> tuple[float, Host]:
            with jax.enable_x64(double):
                value, gradient = value_and_grad(given)
                gradient.block_until_ready()  # computed together with the value
            return float(value), np.asarray(gradient)

        return evaluate

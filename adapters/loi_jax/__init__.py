"""`loi` for JAX: the loss as a function for ``jit``, ``grad`` and ``vmap``, and a renderer."""

from loi_jax.loss import loi_loss

__all__ = ["loi_loss"]

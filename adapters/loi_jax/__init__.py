"""`loi` for JAX: the loss as a function for ``jit``, ``grad`` and ``vmap``, optimisers, and a renderer."""

from loi_jax.loss import loi_loss
from loi_jax.optimisers import OptaxOptimiser

__all__ = ["OptaxOptimiser", "loi_loss"]

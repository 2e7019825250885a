"""`loi` for JAX: the loss as a function for ``jit``, ``grad`` and ``vmap``, optimisers, and a renderer."""

# ruff: noqa: E402 - JAX is missing where there is only a folder of its name
from loi_core.support.installed import import_library

import_library("jax")

from loi_jax.loss import loi_loss
from loi_jax.optimisers import OptaxOptimiser

__all__ = ["OptaxOptimiser", "loi_loss"]

"""The names of :mod:`loi_jax`."""

from loi._extras import extra

with extra("jax"):
    from loi_jax import *
    from loi_jax import __all__ as __all__

"""The names of :mod:`loi_torch.vector`."""

from loi._extras import extra

with extra("svg"):
    from loi_torch.vector import *
    from loi_torch.vector import __all__ as __all__

"""The names of :mod:`loi_torch`."""

from loi._extras import extra

with extra("torch"):
    from loi_torch import *
    from loi_torch import __all__ as __all__

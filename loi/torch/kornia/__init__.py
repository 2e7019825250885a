"""The names of :mod:`loi_torch.kornia`."""

from loi._extras import extra

with extra("kornia"):
    from loi_torch.kornia import *
    from loi_torch.kornia import __all__ as __all__

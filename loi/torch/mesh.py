"""The names of :mod:`loi_torch.mesh`."""

from loi._extras import extra

with extra("mesh"):
    from loi_torch.mesh import *
    from loi_torch.mesh import __all__ as __all__

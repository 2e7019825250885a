"""The names of :mod:`loi_torch.kornia.cameras`."""

from loi._extras import extra

with extra("mesh"):
    from loi_torch.kornia.cameras import *
    from loi_torch.kornia.cameras import __all__ as __all__

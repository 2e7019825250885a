"""The names of :mod:`loi_core.testing`."""

from loi_core.testing import *
from loi_core.testing import __all__ as __all__

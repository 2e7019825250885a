"""The names of :mod:`loi_core.stability`."""

from loi_core.stability import *
from loi_core.stability import __all__ as __all__

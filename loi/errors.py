"""The names of :mod:`loi_core.errors`."""

from loi_core.errors import *
from loi_core.errors import __all__ as __all__

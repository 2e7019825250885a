"""The names of :mod:`loi_core.objectives`."""

from loi_core.objectives import *
from loi_core.objectives import __all__ as __all__

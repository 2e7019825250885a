"""The names of :mod:`loi_core.sweeps`."""

from loi_core.sweeps import *
from loi_core.sweeps import __all__ as __all__

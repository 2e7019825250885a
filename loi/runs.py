"""The names of :mod:`loi_core.runs`."""

from loi_core.runs import *
from loi_core.runs import __all__ as __all__

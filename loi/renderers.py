"""The names of :mod:`loi_core.renderers`."""

from loi_core.renderers import *
from loi_core.renderers import __all__ as __all__

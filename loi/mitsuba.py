"""The names of :mod:`loi_mitsuba`."""

from loi._extras import extra

with extra("mitsuba"):
    from loi_mitsuba import *
    from loi_mitsuba import __all__ as __all__

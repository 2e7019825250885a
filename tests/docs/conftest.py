"""Settings for the tests of the documentation, whose pages use the frameworks."""

from __future__ import annotations

import importlib.util

if importlib.util.find_spec("mitsuba") is not None:
    import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

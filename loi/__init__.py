"""`loi`: locally orderless images as a loss for inverse rendering, on any array library and any renderer.

One namespace for the library: the public names and modules of `loi_core`, and the adapters `loi_torch`, `loi_jax` and
`loi_mitsuba` as ``loi.torch``, ``loi.jax`` and ``loi.mitsuba``. Each module is imported when it is first used.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any, Final

_MODULES: Final = (
    "errors",
    "jax",
    "mitsuba",
    "objectives",
    "renderers",
    "runs",
    "stability",
    "sweeps",
    "testing",
    "torch",
)

if TYPE_CHECKING:
    from loi import errors, jax, mitsuba, objectives, renderers, runs, stability, sweeps, testing, torch
    from loi_core import *
    from loi_core import __all__ as __all__
    from loi_core import __version__ as __version__
else:  # a type checker that saw this function would accept every name

    def __getattr__(name: str) -> Any:
        if name in _MODULES:
            return importlib.import_module(f"loi.{name}")
        core = importlib.import_module("loi_core")
        if name != "__all__" and name not in core.__all__:
            msg = f"module 'loi' has no attribute {name!r}"
            raise AttributeError(msg, name=name, obj=sys.modules[__name__])
        value = globals()[name] = getattr(core, name)
        return value


def __dir__() -> list[str]:
    return sorted([*importlib.import_module("loi_core").__all__, *_MODULES])

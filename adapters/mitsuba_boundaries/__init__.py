"""Integrators of Mitsuba whose gradients have the boundary terms that Mitsuba's projective integrators lack.

Importing this package registers ``direct_boundaries`` and ``prb_boundaries``. They extend ``direct_projective`` and
``prb_projective``, and take the same properties.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may need to be given another one.
"""

# ruff: noqa: E402 - LLVM is chosen before Dr.Jit is imported
import importlib.util

from mitsuba_boundaries.llvm import LLVMChoice, LLVMError, prepare

# Without this check, the error would be a missing `drjit`.
if importlib.util.find_spec("mitsuba") is None:
    msg = "No module named 'mitsuba'"
    raise ModuleNotFoundError(msg, name="mitsuba")
prepare()

import mitsuba as mi

from mitsuba_boundaries.integrators import INTEGRATORS, register_integrators

register_integrators()
mi.detail.add_variant_callback(register_integrators)

__all__ = ["INTEGRATORS", "LLVMChoice", "LLVMError", "prepare"]

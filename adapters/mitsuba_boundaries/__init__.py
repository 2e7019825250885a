"""Gradients that Mitsuba lacks: integrators with all boundary terms, and scenes that have gradients.

Importing this package registers ``direct_boundaries`` and ``prb_boundaries``. They extend ``direct_projective`` and
``prb_projective``, and take the same properties. :func:`differentiable_scene` replaces the parts of a scene that have
no gradient in any integrator, such as point lights and mirrors.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may need to be given another one.
"""

# ruff: noqa: E402 - LLVM is chosen before Dr.Jit is imported
import importlib.util

from mitsuba_boundaries.llvm import LLVMChoice, LLVMError, prepare

# Without this check, the error would be a missing `drjit`. Python finds any folder of the name, which has no origin.
_spec = importlib.util.find_spec("mitsuba")
if _spec is None or _spec.origin is None:
    msg = "No module named 'mitsuba'"
    raise ModuleNotFoundError(msg, name="mitsuba")
prepare()

import mitsuba as mi

from mitsuba_boundaries.integrators import INTEGRATORS, register_integrators
from mitsuba_boundaries.proxy.scene import ProxySettings, differentiable_scene
from mitsuba_boundaries.proxy.substitutions import Substitution

register_integrators()
mi.detail.add_variant_callback(register_integrators)

__all__ = [
    "INTEGRATORS",
    "LLVMChoice",
    "LLVMError",
    "ProxySettings",
    "Substitution",
    "differentiable_scene",
    "prepare",
]

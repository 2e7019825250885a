"""Locally orderless images in Mitsuba 3 and Dr.Jit.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may need to be given another one.
"""

from mitsuba_boundaries import LLVMChoice, LLVMError, prepare  # isort: skip - chooses LLVM before Dr.Jit is imported

from loi_core.renderers.verification import Verification
from loi_mitsuba.diagnostics import GradientWarning
from loi_mitsuba.effects.capabilities import CAPABILITIES
from loi_mitsuba.effects.plan import plan_effects
from loi_mitsuba.effects.renderer import PlannedRenderer
from loi_mitsuba.loss import BackendMissingError, loi_loss
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import SceneLoadError
from loi_mitsuba.scene.parameters import SceneParameter, list_parameters
from loi_mitsuba.scene.poses import Rotate, Scale, Translate
from mitsuba_boundaries.proxy.scene import ProxySettings


def diagnose() -> list[tuple[str, str]]:
    """Return the name and detail of each finding that ``loi doctor`` lists for this adapter."""
    choice = prepare()
    version = "none found; only the scalar and CUDA variants work" if choice.version is None else str(choice.version)
    return [("LLVM", f"{version} ({choice.source})")]


__all__ = [
    "CAPABILITIES",
    "BackendMissingError",
    "GradientWarning",
    "LLVMChoice",
    "LLVMError",
    "MitsubaRenderer",
    "PlannedRenderer",
    "ProxySettings",
    "Rotate",
    "Scale",
    "SceneLoadError",
    "SceneParameter",
    "Translate",
    "Verification",
    "diagnose",
    "list_parameters",
    "loi_loss",
    "plan_effects",
    "prepare",
]

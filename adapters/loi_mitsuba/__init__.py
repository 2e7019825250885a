"""Locally orderless images in Mitsuba 3 and Dr.Jit.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may have to be told which one.
"""

# ruff: noqa: E402 - LLVM is chosen before anything imports Dr.Jit
import importlib.util

from loi_mitsuba.drjit.llvm import LLVMChoice, LLVMError, choose_llvm, prepare

# Without Mitsuba there is nothing to prepare, and "not installed" says more than that there is no LLVM.
if importlib.util.find_spec("mitsuba") is None:
    msg = "No module named 'mitsuba'"
    raise ModuleNotFoundError(msg, name="mitsuba")
prepare()

from loi_mitsuba.diagnostics import GradientWarning
from loi_mitsuba.effects.capabilities import CAPABILITIES
from loi_mitsuba.effects.plan import plan_effects
from loi_mitsuba.effects.renderer import PlannedRenderer
from loi_mitsuba.effects.verify import Verification
from loi_mitsuba.loss import BackendMissingError, LOILoss
from loi_mitsuba.proxy.scene import ProxySettings
from loi_mitsuba.renderer import MitsubaRenderer
from loi_mitsuba.scene.load import SceneLoadError
from loi_mitsuba.scene.parameters import SceneParameter, list_parameters
from loi_mitsuba.scene.poses import Rotate, Scale, Translate


def diagnose() -> list[tuple[str, str]]:
    """What ``loi doctor`` shows of this adapter: name and finding."""
    choice = prepare()
    version = "a version not known yet" if choice.version is None else str(choice.version)
    return [("LLVM", f"{version}, from {choice.source}: {choice.reason}")]


__all__ = [
    "CAPABILITIES",
    "BackendMissingError",
    "GradientWarning",
    "LLVMChoice",
    "LLVMError",
    "LOILoss",
    "MitsubaRenderer",
    "PlannedRenderer",
    "ProxySettings",
    "Rotate",
    "Scale",
    "SceneLoadError",
    "SceneParameter",
    "Translate",
    "Verification",
    "choose_llvm",
    "diagnose",
    "list_parameters",
    "plan_effects",
    "prepare",
]

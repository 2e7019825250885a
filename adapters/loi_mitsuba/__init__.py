"""Locally orderless images in Mitsuba 3 and Dr.Jit.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may have to be told which one.
"""

# ruff: noqa: E402 - LLVM is chosen before anything imports Dr.Jit
from loi_mitsuba.llvm import LLVMChoice, LLVMError, choose_llvm, prepare

prepare()

from loi_mitsuba.cautions import GradientWarning
from loi_mitsuba.entries import Entry, list_entries
from loi_mitsuba.handles import Rotate, Scale, Translate
from loi_mitsuba.loss import BackendMissingError, LOILoss
from loi_mitsuba.renderer import MitsubaRenderer, SceneLoadError

__all__ = [
    "BackendMissingError",
    "Entry",
    "GradientWarning",
    "LLVMChoice",
    "LLVMError",
    "LOILoss",
    "MitsubaRenderer",
    "Rotate",
    "Scale",
    "SceneLoadError",
    "Translate",
    "choose_llvm",
    "list_entries",
    "prepare",
]

"""Locally orderless images in Mitsuba 3 and Dr.Jit.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may have to be told which one.
"""

from loi_mitsuba.llvm import LLVMChoice, LLVMError, choose_llvm, prepare

prepare()  # before anything that imports Dr.Jit

__all__ = ["LLVMChoice", "LLVMError", "choose_llvm", "prepare"]

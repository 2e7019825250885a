"""Helpers for Dr.Jit: LLVM, memory and ragged tables."""

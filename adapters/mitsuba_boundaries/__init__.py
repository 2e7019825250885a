"""Boundary terms of the gradient of images that Mitsuba's projective integrators lack.

Import this package before `mitsuba`: Dr.Jit loads LLVM while it is imported, and may need to be given another one.
"""

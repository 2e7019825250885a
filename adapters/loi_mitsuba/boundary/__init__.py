"""Boundary terms of the gradient: one module for each kind of discontinuity."""

"""Table 2 of the paper: shadows, caustics, 65 primitives and a highlight, fitted through a path tracer."""

from examples.paper.table2.command import main

__all__ = ["main"]

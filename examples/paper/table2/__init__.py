"""The paper's Table 2: shadows, caustics, 65 primitives and a highlight, found through a path tracer."""

from examples.paper.table2.command import main

__all__ = ["main"]

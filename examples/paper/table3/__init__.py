"""Table 3 of the paper: poses, shapes, cameras, materials and light, fitted through a mesh rasteriser."""

from examples.paper.table3.command import main

__all__ = ["main"]

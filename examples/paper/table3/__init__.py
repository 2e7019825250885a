"""The paper's Table 3: poses, shapes, cameras, materials and light, found through a rasterizer of meshes."""

from examples.paper.table3.command import main

__all__ = ["main"]

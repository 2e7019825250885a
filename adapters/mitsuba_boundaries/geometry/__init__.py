"""Geometry of shapes: meshes, edges, bounds and textures with steps."""

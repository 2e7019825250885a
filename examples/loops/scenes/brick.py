"""A brick under a sun in Blender, seen from above; another program would open its .blend file."""

import tempfile
from pathlib import Path
from typing import Any

import bpy


def build() -> tuple[Any, Any]:
    """Return the scene, whose renders of 64x48 pixels go into a temporary file, and the brick."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.object.camera_add(location=(0.0, 0.0, 10.0))  # looks down
    scene.camera = bpy.context.object
    bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0.0))
    bpy.context.object.data.energy = 3.0
    bpy.ops.mesh.primitive_cube_add(scale=(0.9, 0.4, 0.4))
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.render.image_settings.color_mode = "RGB"
    scene.render.filepath = str(Path(tempfile.mkdtemp()) / "render.png")
    return scene, bpy.context.object

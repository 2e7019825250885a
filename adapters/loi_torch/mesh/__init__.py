"""Triangle meshes on torch: images with gradients for geometry, camera and appearance, also at outlines."""

from loi_core.renderers.poses import Rotate, Scale, Translate
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.drawing import draw, draw_positions
from loi_torch.mesh.gltf_cameras import read_cameras
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Material, Mesh, MeshWarning
from loi_torch.mesh.reading import read_mesh, read_meshes
from loi_torch.mesh.renderer import MeshRenderer
from loi_torch.mesh.shapes import box, quad, sphere

__all__ = [
    "Camera",
    "Environment",
    "Light",
    "Material",
    "Mesh",
    "MeshRenderer",
    "MeshWarning",
    "Rotate",
    "Scale",
    "Translate",
    "box",
    "draw",
    "draw_positions",
    "quad",
    "read_cameras",
    "read_mesh",
    "read_meshes",
    "sphere",
]

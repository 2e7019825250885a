"""The scene of PyTorch3D's tutorial of cameras, smaller, with a pot in place of the teapot, which is a download."""

import math

import torch
from pytorch3d.renderer import (
    BlendParams,
    FoVPerspectiveCameras,
    MeshRasterizer,
    MeshRenderer,
    RasterizationSettings,
    SoftSilhouetteShader,
)
from pytorch3d.structures import Meshes

from loi_torch.mesh import box, sphere

SOLIDS = (
    sphere(0.7, subdivisions=2),
    sphere(0.2, (0.0, 0.75, 0.0), subdivisions=1),  # the knob
    box((0.7, 0.2, 0.2), (0.85, 0.15, 0.0)),  # the spout
    box((0.2, 0.6, 0.15), (1.2, 0.35, 0.0)),
    box((0.5, 0.12, 0.12), (-0.8, 0.35, 0.0)),  # the handle
    box((0.12, 0.6, 0.12), (-1.0, 0.1, 0.0)),
)


def build(device: torch.device) -> tuple[Meshes, MeshRenderer]:
    """Return the pot, about 2 units wide, and a renderer of its silhouette."""
    vertices = torch.cat([solid.vertices for solid in SOLIDS]).float()
    firsts = [sum(len(solid.vertices) for solid in SOLIDS[:index]) for index in range(len(SOLIDS))]
    faces = torch.cat([torch.as_tensor(solid.faces) + first for solid, first in zip(SOLIDS, firsts, strict=True)])
    blend = BlendParams(sigma=1e-4, gamma=1e-4)
    blur_radius = math.log(1.0 / 1e-4 - 1.0) * blend.sigma
    settings = RasterizationSettings(image_size=64, blur_radius=blur_radius, faces_per_pixel=10)
    rasterizer = MeshRasterizer(cameras=FoVPerspectiveCameras(device=device), raster_settings=settings)
    renderer = MeshRenderer(rasterizer=rasterizer, shader=SoftSilhouetteShader(blend_params=blend))
    return Meshes(verts=[vertices.to(device)], faces=[faces.to(device)]), renderer

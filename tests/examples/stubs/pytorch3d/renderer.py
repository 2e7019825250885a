"""A renderer of silhouettes, with PyTorch3D's axes: x to the left, y up, z forward, and points as rows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from loi_torch.mesh import Camera, Mesh, draw
from pytorch3d.structures import Meshes


@dataclass(frozen=True)
class FoVPerspectiveCameras:
    fov: float = 60.0
    device: Any = "cpu"


@dataclass(frozen=True)
class BlendParams:
    sigma: float = 1e-4
    gamma: float = 1e-4


@dataclass(frozen=True)
class RasterizationSettings:
    image_size: int = 256
    blur_radius: float = 0.0
    faces_per_pixel: int = 1


@dataclass(frozen=True)
class MeshRasterizer:
    cameras: FoVPerspectiveCameras
    raster_settings: RasterizationSettings


@dataclass(frozen=True)
class SoftSilhouetteShader:
    blend_params: BlendParams = field(default_factory=BlendParams)


@dataclass(frozen=True)
class MeshRenderer:
    rasterizer: MeshRasterizer
    shader: SoftSilhouetteShader

    def __call__(self, meshes_world: Meshes, *, R: Tensor, T: Tensor) -> Tensor:  # noqa: N803  # PyTorch3D's names
        """Return an image with an opacity, shape (1, H, W, 4)."""
        size, fov = self.rasterizer.raster_settings.image_size, torch.tensor(self.rasterizer.cameras.fov)
        focal = 0.5 * size / float(torch.tan(0.5 * torch.deg2rad(fov)))
        intrinsics = [[focal, 0.0, 0.5 * size], [0.0, focal, 0.5 * size], [0.0, 0.0, 1.0]]
        flipped = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
        world_to_camera = flipped @ torch.cat([R[0].double().T, T[0].double()[:, None]], dim=1)
        mesh = Mesh(meshes_world.verts[0], meshes_world.faces[0], colours=(1.0, 1.0, 1.0))
        image = draw([mesh], Camera.from_matrix(intrinsics, world_to_camera), size, size, lights=[])
        return image[None][..., [0, 1, 2, 0]].float()


def look_at_rotation(camera_position: Tensor, *, device: Any = "cpu") -> Tensor:
    """Return the rotation, shape (1, 3, 3), of a camera at a position, shape (1, 3), that looks at the origin."""
    z = torch.nn.functional.normalize(-camera_position)
    x = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor([[0.0, 1.0, 0.0]], device=device), z))
    return torch.stack([x, torch.linalg.cross(z, x), z], dim=2)

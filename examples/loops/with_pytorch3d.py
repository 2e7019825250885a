"""Find a camera by a silhouette with PyTorch3D: ``python -m examples.loops.with_pytorch3d``.

It needs PyTorch3D. Renders are (N, H, W, 4), so opacities [..., 3:] go into the loss as they are.
"""

import numpy as np
import torch
from pytorch3d.renderer import (
    BlendParams,
    FoVPerspectiveCameras,
    MeshRasterizer,
    MeshRenderer,
    RasterizationSettings,
    SoftSilhouetteShader,
    look_at_view_transform,
)
from pytorch3d.structures import Meshes

import loi_torch

device = torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
vertices = torch.tensor([[-0.6, -0.4, -0.4], [0.9, -0.4, -0.4], [0.0, -0.4, 0.8], [0.0, 0.8, 0.0]], device=device)
faces = torch.tensor([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]], device=device)
mesh = Meshes(verts=[vertices], faces=[faces])
blend = BlendParams(sigma=1e-4, gamma=1e-4)
blur_radius = float(np.log(1.0 / 1e-4 - 1.0)) * blend.sigma
settings = RasterizationSettings(image_size=64, blur_radius=blur_radius, faces_per_pixel=10)
rasterizer = MeshRasterizer(cameras=FoVPerspectiveCameras(device=device), raster_settings=settings)
renderer = MeshRenderer(rasterizer=rasterizer, shader=SoftSilhouetteShader(blend_params=blend))
rotation, _ = look_at_view_transform(5.0, 20.0, 30.0, device=device)


def render(translation: torch.Tensor) -> torch.Tensor:
    """Render the silhouette, shape (1, H, W, 1), from a camera's translation."""
    image: torch.Tensor = renderer(meshes_world=mesh, R=rotation, T=translation[None])
    return image[..., 3:]


truth = torch.tensor([1.4, 1.1, 5.0], device=device)
silhouette = render(truth).detach()


def error(loss: torch.nn.Module) -> float:
    """Return the error of the translation that Adam reaches from the opposite corner, in world units."""
    translation = torch.tensor([-1.3, -1.2, 6.0], device=device, requires_grad=True)
    optimizer = torch.optim.Adam([translation], lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 200)
    for _ in range(200):
        optimizer.zero_grad()
        loss(render(translation), silhouette).backward()
        optimizer.step()
        schedule.step()
    return float(torch.linalg.vector_norm(translation.detach() - truth))


print("L2 ", round(error(torch.nn.MSELoss()), 2))
print("loi", round(error(loi_torch.LOILoss()), 2))

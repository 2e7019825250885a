"""Find a camera by a silhouette with PyTorch3D: ``python -m examples.loops.with_pytorch3d``.

It needs PyTorch3D. It has the model, start, optimiser and steps of PyTorch3D's own tutorial of cameras.
"""

import torch
from pytorch3d.renderer import look_at_rotation

import loi_torch
from examples.loops.scenes import pot

device = torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
mesh, renderer = pot.build(device)


class Model(torch.nn.Module):
    """The silhouette from a camera that looks at the origin, shape (1, H, W, 1)."""

    def __init__(self, position: list[float]) -> None:
        super().__init__()
        self.camera_position = torch.nn.Parameter(torch.tensor(position, device=device))

    def forward(self) -> torch.Tensor:
        """Render the opacity, the fourth channel of images (N, H, W, 4)."""
        rotation = look_at_rotation(self.camera_position[None], device=device)
        translation = -torch.bmm(rotation.mT, self.camera_position[None, :, None])[:, :, 0]
        image: torch.Tensor = renderer(meshes_world=mesh, R=rotation, T=translation)
        return image[..., 3:]


truth = Model([0.0, 2.298, 1.928])
silhouette = truth().detach()


def error(loss: torch.nn.Module) -> float:
    """Return the error of the camera's position that Adam reaches, in world units."""
    model = Model([3.0, 6.9, 2.5])
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    for _ in range(200):
        optimizer.zero_grad()
        loss(model(), silhouette).backward()
        optimizer.step()
    return float(torch.linalg.vector_norm(model.camera_position - truth.camera_position).detach())


print("L2 ", round(error(torch.nn.MSELoss()), 2))
print("loi", round(error(loi_torch.LOILoss()), 2))

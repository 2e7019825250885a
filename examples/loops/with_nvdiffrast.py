"""Find turns of a cube with nvdiffrast: ``python -m examples.loops.with_nvdiffrast``.

It needs a CUDA GPU and nvdiffrast, ``pip install git+https://github.com/NVlabs/nvdiffrast``. It follows
nvdiffrast's own sample of poses, smaller and without its random search.
"""

import nvdiffrast.torch as dr
import torch
from kornia.geometry.conversions import quaternion_to_rotation_matrix

import loi_torch
from examples.loops.scenes import cube

device = "cuda" if torch.cuda.is_available() else "cpu"
positions, triangles, colours, to_clip = cube.build(device)
truth, start = cube.turns(16, device)
context = dr.RasterizeCudaContext()


def render(quaternions: torch.Tensor) -> torch.Tensor:
    """Render the cube turned by each of N quaternions, shape (N, 48, 48, 3)."""
    turned = positions @ quaternion_to_rotation_matrix(quaternions).mT
    clip = torch.nn.functional.pad(turned, (0, 1), value=1.0) @ to_clip.T
    raster, _ = dr.rasterize(context, clip, triangles, resolution=[48, 48])
    image, _ = dr.interpolate(colours[None], raster, triangles)
    blended: torch.Tensor = dr.antialias(image, raster, clip, triangles)
    return blended


photographs = render(truth)


def found_count(loss: torch.nn.Module) -> int:
    """Return the number of turns that Adam finds within 5 degrees."""
    quaternions = start.clone().requires_grad_()
    optimizer = torch.optim.Adam([quaternions], lr=0.02)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 150)
    for _ in range(150):
        optimizer.zero_grad()
        loss(render(quaternions), photographs).backward()
        optimizer.step()
        schedule.step()
    off = 2.0 * torch.acos((torch.nn.functional.normalize(quaternions.detach()) * truth).sum(1).abs().clamp(max=1.0))
    return int((torch.rad2deg(off) < 5.0).sum())


print("L2 ", found_count(torch.nn.MSELoss()))
print("loi", found_count(loi_torch.LOILoss()))

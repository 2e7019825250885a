"""Find the position of a cube with nvdiffrast: ``python -m examples.loops.with_nvdiffrast``.

It needs a CUDA GPU and nvdiffrast, ``pip install git+https://github.com/NVlabs/nvdiffrast``. The loss
runs on the GPU as the renderer does.
"""

import nvdiffrast.torch as dr
import torch

import loi_torch

height, width = 256, 256
context = dr.RasterizeCudaContext()
projection = torch.tensor([[2.5, 0, 0, 0], [0, 2.5, 0, 0], [0, 0, -1.2, -2.2], [0, 0, -1, 0]], device="cuda")
corners = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)], device="cuda")
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = torch.tensor([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=torch.int32, device="cuda")
colours = 0.5 + 0.5 * corners


def render(position: torch.Tensor) -> torch.Tensor:
    """Render the cube at a position in front of the camera, shape (height, width, 3)."""
    points = 0.5 * corners + position
    clip = torch.nn.functional.pad(points, (0, 1), value=1.0) @ projection.T
    raster, _ = dr.rasterize(context, clip[None], faces, resolution=[height, width])
    interpolated, _ = dr.interpolate(colours[None], raster, faces)
    image: torch.Tensor = dr.antialias(interpolated, raster, clip[None], faces)[0]
    return image


with torch.no_grad():
    photograph = render(torch.tensor([1.0, -0.6, -6.0], device="cuda"))
position = torch.tensor([-1.0, 0.8, -6.0], device="cuda", requires_grad=True)
optimizer = torch.optim.Adam([position], lr=0.05)

loss = loi_torch.LOILoss()
for _ in range(300):
    optimizer.zero_grad()
    loss(render(position), photograph).backward()
    optimizer.step()

print(*(round(value, 1) for value in position.tolist()))

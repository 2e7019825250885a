"""The same images by nvdiffrast, on a GPU: its rasterizer and its antialiasing, our surfaces and lights.

nvdiffrast is not on PyPI, and this module needs it and a CUDA device. Its antialiasing follows outlines between pairs
of neighbouring pixels only (Laine et al. 2020): coverage is not exact, and neither creases between two visible sides
nor lines along which meshes cut into each other have a gradient.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import BackendNotFoundError
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.drawing import Frame, shade
from loi_torch.mesh.lighting import Environment, Light
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.projected import Projected, Seen

__all__ = ["draw_by_nvdiffrast"]


def draw_by_nvdiffrast(
    meshes: Sequence[Mesh],
    camera: Camera,
    height: int,
    width: int,
    *,
    lights: Sequence[Light] = (),
    environment: Environment | None = None,
    background: Any = 0.0,
) -> Tensor:
    """The image of meshes whose tensors are on a CUDA device; arguments as those of :func:`loi_torch.mesh.draw`.

    Returns
    -------
    Tensor, shape (height, width, 3), float64
        On that device.

    Raises
    ------
    BackendNotFoundError
        If nvdiffrast or a CUDA device is missing.
    """
    library, context = _context()
    frame = Frame(meshes, camera, height, width, look=_nothing)
    clip = _clip_space(frame, camera)
    faces = torch.as_tensor(frame.topology.faces, dtype=torch.int32, device=frame.device)
    raster, _ = library.rasterize(context, clip[None], faces, (height, width))
    found = raster[0, ..., 3].reshape(-1).to(torch.int64) - 1
    covered = torch.nonzero(found >= 0)[:, 0]
    samples = frame.samples(found[covered].cpu().numpy(), frame.centres(covered.cpu().numpy()))
    image = frame.behind(background).index_copy(0, covered, shade(frame, samples, lights, environment))
    smooth = library.antialias(image.reshape(1, height, width, 3).float().contiguous(), raster, clip[None], faces)
    result: Tensor = smooth[0].to(torch.float64)
    return result


@functools.cache
def _context() -> tuple[Any, Any]:
    try:
        import nvdiffrast.torch as library
    except ImportError as error:
        msg = "nvdiffrast is not installed: pip install git+https://github.com/NVlabs/nvdiffrast"
        raise BackendNotFoundError(msg) from error
    if not torch.cuda.is_available():
        msg = "nvdiffrast needs a CUDA device, and torch finds none"
        raise BackendNotFoundError(msg)
    return library, library.RasterizeCudaContext()


def _clip_space(frame: Frame, camera: Camera) -> Tensor:
    """Corners as OpenGL has them, shape (n, 4), float32; row 0 of nvdiffrast's image is at y = -1, ours at the top."""
    height, width = frame.size
    x, y, w = frame.corners.unbind(dim=1)
    if camera.extent is None:
        z = w - 2.0 * camera.near  # -w at the near plane, and w far away
    else:
        deepest = frame.depth.detach().abs().max().clamp(min=1.0)
        z = -frame.depth / deepest
    return torch.stack([2.0 * x / width - w, 2.0 * y / height - w, z, w], dim=1).float().contiguous()


def _nothing(scene: Projected) -> Seen:
    """What our own looking would have found: nothing, as nvdiffrast looks."""
    none, pair = np.zeros(0, np.int32), np.zeros((0, 2), np.int32)
    empty = np.full(scene.view.height * scene.view.width, -1, np.int32)
    spans, ends = np.zeros((0, 2)), np.zeros((0, 4))
    return Seen(empty, none, spans, none, pair, pair, none, pair, ends, lambda *_: pair)

"""Meshes projected to the image, and the triangle visible at each sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.renderers.validation import check_size
from loi_core.support.arrays import to_numpy
from loi_core.support.wording import shown
from loi_torch.mesh.barycentric import SurfaceSamples
from loi_torch.mesh.cameras import Camera
from loi_torch.mesh.lighting import Environment
from loi_torch.mesh.meshes import Mesh
from loi_torch.mesh.tensors import background_tensor
from loi_torch.mesh.topology import concatenate
from loi_torch.mesh.visibility import find_visible
from loi_torch.mesh.visibility.types import ProjectedScene

__all__ = ["Frame"]


class Frame:
    """Meshes projected to an image, with their visible triangles and edge segments.

    `vertices` are in world units; `corners` and `depth` are their projection by :meth:`Camera.project`. The `topology`,
    the projected `scene` and its `visible` segments carry no gradients.
    """

    def __init__(self, meshes: Sequence[Mesh], camera: Camera, height: int, width: int) -> None:
        if isinstance(meshes, Mesh) or not all(isinstance(mesh, Mesh) for mesh in meshes):
            msg = f"`meshes` must be a list of Mesh, got {shown(meshes)}"
            raise ParameterError(msg)
        if not isinstance(camera, Camera):
            msg = f"`camera` must be a Camera, got {shown(camera)}"
            raise ParameterError(msg)
        height, width = check_size("height", height), check_size("width", width)
        self.meshes, self.camera = meshes, camera
        self.size = height, width
        vertices = [mesh.vertices for mesh in meshes]
        self.vertices = torch.cat(vertices) if meshes else torch.zeros((0, 3), dtype=torch.float64)
        counts = [len(mesh.vertices) for mesh in meshes]
        self.first_vertex = np.append(0, np.cumsum(counts)).astype(np.int64)
        self.first_triangle = np.append(0, np.cumsum([len(mesh.faces) for mesh in meshes])).astype(np.int64)
        self.topology = concatenate([mesh.topology for mesh in meshes], counts)
        self.corners, self.depth = camera.project(self.vertices, height, width)
        self.scene = ProjectedScene(
            self.topology,
            camera.viewport(height, width),
            to_numpy(self.corners.detach()),
            to_numpy(self.depth.detach()),
        )
        self.visible = find_visible(self.scene)

    def index_tensor(self, indices: Any) -> Tensor:
        """Return indices as an int64 tensor."""
        return torch.as_tensor(indices, dtype=torch.int64)

    def pixel_centres(self, pixels: Any) -> Tensor:
        """Return the centres (x, y) of pixels, shape (s, 2)."""
        width = self.size[1]
        return torch.as_tensor(np.stack([pixels % width + 0.5, pixels // width + 0.5], axis=1))

    def samples(self, triangle: Any, points: Tensor) -> SurfaceSamples:
        """Return samples of triangles, shape (s,), at points, shape (s, 2)."""
        return SurfaceSamples(
            self.index_tensor(self.topology.faces[triangle]),
            self.index_tensor(np.searchsorted(self.first_triangle, triangle, side="right") - 1),
            points,
            self.index_tensor(triangle),
        )

    def facing(self, triangle: Any) -> Any:
        """Return the sign of the volume between the eye and each triangle, which depends on the side that it shows."""
        faces = self.topology.faces
        return np.sign(np.linalg.det(self.scene.corners[faces[triangle]])) if len(faces) else triangle

    def background(self, background: Any) -> Tensor:
        """Return the background colour of every pixel, shape (H * W, 3)."""
        height, width = self.size
        if isinstance(background, Environment):
            centres = self.pixel_centres(np.arange(height * width))
            directions = self.camera.directions(centres, height, width)
            return background.radiance(directions, self.pixel_angle(height * width))
        colours = background_tensor(background, height, width)
        return colours.reshape(-1, 3) if colours.ndim == 3 else colours.expand(height * width, 3)

    def finished(self, image: Tensor) -> Tensor:
        """Return pixels, shape (H * W, c), as an image on the device of the meshes, or else of the camera."""
        devices = [mesh.device for mesh in self.meshes if mesh.device is not None]
        device = devices[0] if devices else self.camera.device
        return self._connected(image).reshape(*self.size, -1).to(device or "cpu")

    def _connected(self, image: Tensor) -> Tensor:
        """Return the image as part of the graph of meshes and camera, with gradient 0 if none of them is visible."""
        if image.requires_grad:
            return image
        leaves = [value for mesh in self.meshes for value in (mesh.vertices, mesh.colours, mesh.texture)]
        camera = self.camera
        leaves += [camera.position, camera.target, camera.up, camera.fov, camera.extent]
        leaves += [camera.focal, camera.principal_point, camera.skew]
        for value in leaves:
            if value is not None and value.requires_grad:
                image = image + 0.0 * value.sum()
        return image

    def pixel_angle(self, count: int) -> Tensor:
        """Return the approximate angle that a pixel subtends, in radians, shape (count,)."""
        return torch.full((count,), self.camera.pixel_angle(self.size[0]), dtype=torch.float64)

"""Triangle meshes with what they are made of."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.arrays import to_numpy
from loi_core.support.wording import shown
from loi_torch.mesh.projected import IndexArray
from loi_torch.mesh.tensors import tensor_of, unit
from loi_torch.mesh.topology import joined_corners, topology_of

__all__ = ["Material", "Mesh", "MeshWarning"]


class MeshWarning(UserWarning):
    """A mesh, or the file that it is from, has something that its images will not show."""


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface reflects light: Blinn-Phong, and a mirror for the environment.

    Light reaches the eye as ``colour * (ambient + diffuse * n.l) + specular * (n.h) ** shininess``, summed over lights,
    plus ``mirror`` times the environment in the mirrored direction. `colour` is the mesh's own.

    Parameters
    ----------
    ambient, diffuse, specular, mirror : float or array, shape (3,)
        Shares, linear RGB.
    shininess : float
        Exponent, more than 0.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or range.
    """

    ambient: Any = 0.1
    diffuse: Any = 0.8
    specular: Any = 0.1
    mirror: Any = 0.0
    shininess: Any = 32.0

    def __post_init__(self) -> None:
        for one in fields(self):
            shape = () if one.name == "shininess" else (3,)
            value = tensor_of(one.name, getattr(self, one.name))
            if value.shape not in ((), shape):
                msg = f"`{one.name}` must be a number{' or three' if shape else ''}, got shape {tuple(value.shape)}"
                raise ParameterError(msg)
            object.__setattr__(self, one.name, value.expand(shape))
        if not float(self.shininess.detach()) > 0.0:
            msg = f"`shininess` must be more than 0, got {float(self.shininess.detach()):g}"
            raise ParameterError(msg)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with colours.

    Parameters
    ----------
    vertices : array, shape (n, 3)
        Corners in world units; any of these may be tensors that require gradients.
    faces : array of int, shape (m, 3)
        Corners of each triangle, counterclockwise as seen from outside.
    colours : array, shape (3,), (n, 3) or (m, 3), optional
        Linear RGB: of all, of each vertex, or of each triangle; 0.8 by default.
    per : {"vertex", "triangle"}
        What the rows of `colours` are of; said only where there are as many vertices as triangles.
    uv : array, shape (n, 2), optional
        Texture coordinates; (0, 0) is the texture's bottom left corner, and textures repeat.
    texture : array, shape (h, w, 3), optional
        Linear RGB, multiplies `colours`, which is 1 by default where there is a texture.
    material : Material
        How it reflects light.
    smooth : bool
        Whether normals are averaged at vertices, and not each triangle's own.
    places, topology, jumping
        Made of the rest. ``dataclasses.replace`` keeps which vertices were in one place: they stay together, at their
        mean. Other faces, or another number of vertices, begin anew.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or a triangle names a vertex that is not there.

    Warns
    -----
    MeshWarning
        If triangles that meet at an edge face opposite ways.
    """

    vertices: Any
    faces: Any
    colours: Any = None
    uv: Any = None
    texture: Any = None
    material: Material = field(default_factory=Material)
    smooth: bool = True
    per: str | None = None
    places: Any = field(default=None, repr=False)
    topology: Any = field(default=None, repr=False)
    jumping: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        vertices = tensor_of("vertices", self.vertices, (None, 3))
        count = len(vertices)
        faces = _checked_faces(self.faces, count)
        put(self, "faces", faces)
        default = (1.0, 1.0, 1.0) if self.texture is not None else (0.8, 0.8, 0.8)
        colours = tensor_of("colours", default if self.colours is None else self.colours)
        put(self, "per", _per(self.per, colours, count, len(faces)))
        put(self, "colours", colours)
        if not isinstance(self.material, Material):
            msg = f"`material` must be a Material, got {shown(self.material)}"
            raise ParameterError(msg)
        if (self.uv is None) != (self.texture is None):
            missing = "uv" if self.uv is None else "texture"
            msg = f"`{missing}` is missing; a textured mesh has both `texture` and `uv`"
            raise ParameterError(msg)
        if self.texture is not None:
            put(self, "uv", tensor_of("uv", self.uv, (count, 2)))
            put(self, "texture", tensor_of("texture", self.texture, (None, None, 3)))
            if not self.texture.numel():
                msg = f"`texture` must have a texel or more, got shape {tuple(self.texture.shape)}"
                raise ParameterError(msg)
        self._connect(vertices)

    def _connect(self, vertices: Tensor) -> None:
        """Find which corners are in one place, and which triangles meet, unless that is known."""
        put = object.__setattr__
        if (
            self.topology is None
            or len(self.places) != len(vertices)
            or not np.array_equal(self.topology.faces, self.faces)
        ):
            put(self, "places", joined_corners(np.asarray(to_numpy(vertices.detach()), dtype=np.float64)))
            put(self, "jumping", None)
        put(self, "vertices", _together(vertices, self.places))
        creased = self.per == "triangle" or not self.smooth
        seams = self.per == "vertex" or self.texture is not None
        if self.jumping == (creased, seams):
            return
        put(self, "topology", topology_of(self.faces, self.places, creased=creased, seams=seams))
        if self.topology.twisted and self.jumping is None:
            msg = (
                f"`faces` must run counterclockwise as seen from outside; at {self.topology.twisted} edges two "
                "triangles face opposite ways, and outlines there may be missed"
            )
            warnings.warn(msg, MeshWarning, stacklevel=4)
        put(self, "jumping", (creased, seams))

    def normals(self) -> Tensor:
        """Unit normals: of vertices, shape (n, 3), or of triangles, shape (m, 3), where they are not smooth."""
        faces = torch.as_tensor(self.faces, device=self.vertices.device, dtype=torch.int64)
        a, b, c = (self.vertices.index_select(0, faces[:, k]) for k in range(3))
        across = torch.linalg.cross(b - a, c - a)
        if self.smooth:
            places = torch.as_tensor(self.places, device=self.vertices.device, dtype=torch.int64)
            count = int(places.max()) + 1 if len(places) else 0
            at = places.index_select(0, faces.reshape(-1))
            summed = across.new_zeros((count, 3)).index_add(0, at, across.repeat_interleave(3, dim=0))
            across = summed.index_select(0, places)
        return unit(across)


def _together(vertices: Tensor, places: IndexArray) -> Tensor:
    """Vertices, of which those that share a place are at their mean."""
    count = int(places.max(initial=-1)) + 1
    if count == len(vertices):
        return vertices
    first = np.empty(count, np.int64)
    first[places[::-1]] = np.arange(len(vertices))[::-1]
    at, leading = (torch.as_tensor(one, device=vertices.device, dtype=torch.int64) for one in (places, first))
    base = vertices.index_select(0, leading)
    # As what is beside the first of each place: exact where all are there, as they are at first.
    off = torch.zeros_like(base).index_add(0, at, vertices - base.index_select(0, at))
    return (base + off / torch.bincount(at)[:, None]).index_select(0, at)


def _checked_faces(value: Any, count: int) -> IndexArray:
    try:
        faces = np.asarray(to_numpy(value) if isinstance(value, Tensor) else value)
    except ValueError as error:  # rows of several lengths
        msg = f"`faces` must be whole numbers of shape (m, 3), got {shown(value)}"
        raise ParameterError(msg) from error
    if faces.size == 0:
        return np.zeros((0, 3), np.int32)
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        msg = f"`faces` must be whole numbers of shape (m, 3), got {faces.dtype} of shape {faces.shape}"
        raise ParameterError(msg)
    if faces.min() < 0 or faces.max() >= count:
        msg = f"`faces` must name vertices 0 to {count - 1}, got {faces.min()} to {faces.max()}"
        raise ParameterError(msg)
    return faces.astype(np.int32)


def _per(said: str | None, colours: Tensor, vertices: int, triangles: int) -> str | None:
    if said not in (None, "vertex", "triangle"):
        msg = f"`per` must be 'vertex' or 'triangle', got {said!r}"
        raise ParameterError(msg)
    shape = tuple(colours.shape)
    if shape == (3,):
        return None
    if shape == (vertices, 3) and said != "triangle":
        return "vertex"
    if shape == (triangles, 3) and said != "vertex":
        return "triangle"
    msg = f"`colours` must have shape (3,), ({vertices}, 3) or ({triangles}, 3), got {shape}"
    raise ParameterError(msg)

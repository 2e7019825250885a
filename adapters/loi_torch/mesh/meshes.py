"""Triangle meshes and their materials."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.support.arrays import to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown
from loi_torch.mesh.tensors import accelerator_of, finite_tensor, unit
from loi_torch.mesh.topology import IndexArray, edge_topology, weld_vertices

__all__ = ["Material", "Mesh", "MeshWarning"]


class MeshWarning(UserWarning):
    """A mesh, or its file, has a property that its images will not show."""


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Material:
    """Blinn-Phong reflection, and mirror reflection of the environment.

    The radiance is ``colour * (ambient + diffuse * n.l) + specular * (n.h) ** shininess``, summed over lights, plus
    ``mirror`` times the environment in the mirrored direction. `colour` belongs to the mesh.

    Parameters
    ----------
    ambient, diffuse, specular, mirror : float or array, shape (3,)
        Reflectances, linear RGB.
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
        for name in (item.name for item in fields(self)):
            shape = () if name == "shininess" else (3,)
            value = finite_tensor(name, getattr(self, name))
            if value.shape not in ((), shape):
                msg = f"`{name}` must be a number{' or three' if shape else ''}, got shape {tuple(value.shape)}"
                raise ParameterError(msg)
            object.__setattr__(self, name, value.expand(shape))
        if not float(self.shininess.detach()) > 0.0:
            msg = f"`shininess` must be more than 0, got {float(self.shininess.detach()):g}"
            raise ParameterError(msg)


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh with colours, and optionally a texture.

    All arrays but `faces` may be tensors that require gradients, on any device. The mesh holds them on the processor,
    where it is drawn; gradients arrive on the devices of the tensors.

    Parameters
    ----------
    vertices : array, shape (n, 3)
        In world units.
    faces : array of int, shape (m, 3)
        Vertices of each triangle, counterclockwise as seen from outside.
    colours : array, shape (3,), (n, 3) or (m, 3), optional
        Linear RGB of the whole mesh, of each vertex, or of each triangle. The default is 0.8, or 1 with a texture.
    uv : array, shape (n, 2), optional
        Texture coordinates; (0, 0) is the texture's bottom left corner, and textures repeat.
    texture : array, shape (h, w, 3), optional
        Linear RGB, multiplied by `colours`.
    material : Material
    smooth : bool
        Whether normals are interpolated between vertices instead of constant on each triangle.
    per : {"vertex", "triangle"}, optional
        Meaning of the rows of `colours`; needed only if there are as many vertices as triangles.
    device : torch.device, optional
        Device of the images of the mesh; by default the first tensor's that is not on the processor.
    welds, topology, discontinuities
        Derived from the other arguments. ``dataclasses.replace`` keeps which vertices coincided at first: they stay
        together, at their mean. With other faces, or another number of vertices, everything is derived anew.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or a triangle has a vertex out of range.

    Warns
    -----
    MeshWarning
        If adjacent triangles face opposite ways.
    """

    vertices: Any
    faces: Any
    colours: Any = None
    uv: Any = None
    texture: Any = None
    material: Material = field(default_factory=Material)
    smooth: bool = True
    per: str | None = None
    device: Any = field(default=None, repr=False)
    welds: Any = field(default=None, repr=False)
    topology: Any = field(default=None, repr=False)
    discontinuities: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self._set(device=accelerator_of(self.vertices, self.colours, self.texture, self.uv) or self.device)
        vertices = finite_tensor("vertices", self.vertices, (None, 3))
        count = len(vertices)
        faces = _checked_faces(self.faces, count)
        default = (1.0, 1.0, 1.0) if self.texture is not None else (0.8, 0.8, 0.8)
        colours = finite_tensor("colours", default if self.colours is None else self.colours)
        self._set(faces=faces, colours=colours, per=_colour_domain(self.per, colours, count, len(faces)))
        if not isinstance(self.material, Material):
            msg = f"`material` must be a Material, got {shown(self.material)}"
            raise ParameterError(msg)
        if (self.uv is None) != (self.texture is None):
            missing = "uv" if self.uv is None else "texture"
            msg = f"`{missing}` is missing; a textured mesh has both `texture` and `uv`"
            raise ParameterError(msg)
        if self.texture is not None:
            uv = finite_tensor("uv", self.uv, (count, 2))
            texture = finite_tensor("texture", self.texture, (None, None, 3))
            if not texture.numel():
                msg = f"`texture` must have at least one texel, got shape {tuple(texture.shape)}"
                raise ParameterError(msg)
            self._set(uv=uv, texture=texture)
        self._update_topology(vertices)

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _update_topology(self, vertices: Tensor) -> None:
        """Weld vertices and find adjacent triangles, unless a replaced mesh has passed on the same ones."""
        if (
            self.topology is None
            or len(self.welds) != len(vertices)
            or not np.array_equal(self.topology.faces, self.faces)
        ):
            welds = weld_vertices(np.asarray(to_numpy(vertices.detach()), dtype=np.float64))
            self._set(welds=welds, discontinuities=None)
        self._set(vertices=_mean_of_welded(vertices, self.welds))
        creased = self.per == "triangle" or not self.smooth
        seams = self.per == "vertex" or self.texture is not None
        if self.discontinuities == (creased, seams):
            return
        self._set(topology=edge_topology(self.faces, self.welds, creased=creased, seams=seams))
        if self.topology.inconsistent_edges and self.discontinuities is None:
            msg = (
                f"`faces` must run counterclockwise as seen from outside; at {self.topology.inconsistent_edges} edges "
                "two triangles face opposite ways, and outlines there may be missed"
            )
            warnings.warn(msg, MeshWarning, stacklevel=4)
        self._set(discontinuities=(creased, seams))

    def normals(self) -> Tensor:
        """Return unit normals of vertices, shape (n, 3), or of triangles, shape (m, 3), if the mesh is not smooth."""
        faces = torch.as_tensor(self.faces, device=self.vertices.device, dtype=torch.int64)
        a, b, c = (self.vertices.index_select(0, faces[:, k]) for k in range(3))
        normals = torch.linalg.cross(b - a, c - a)
        if self.smooth:
            welds = torch.as_tensor(self.welds, device=self.vertices.device, dtype=torch.int64)
            count = int(welds.max()) + 1 if len(welds) else 0
            rows = welds.index_select(0, faces.reshape(-1))
            sums = normals.new_zeros((count, 3)).index_add(0, rows, normals.repeat_interleave(3, dim=0))
            normals = sums.index_select(0, welds)
        return unit(normals)


def _mean_of_welded(vertices: Tensor, welds: IndexArray) -> Tensor:
    """Move vertices that are welded to their mean."""
    count = int(welds.max(initial=-1)) + 1
    if count == len(vertices):
        return vertices
    first = np.empty(count, np.int64)
    first[welds[::-1]] = np.arange(len(vertices))[::-1]
    rows, first_rows = (torch.as_tensor(index, device=vertices.device, dtype=torch.int64) for index in (welds, first))
    base = vertices.index_select(0, first_rows)
    # As offsets from the first vertex of each weld: exact if all coincide, as they do at first.
    offsets = torch.zeros_like(base).index_add(0, rows, vertices - base.index_select(0, rows))
    return (base + offsets / torch.bincount(rows)[:, None]).index_select(0, rows)


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


def _colour_domain(per: str | None, colours: Tensor, vertices: int, triangles: int) -> str | None:
    """Return whether colours belong to vertices or triangles, or None for a single colour."""
    if per not in (None, "vertex", "triangle"):
        msg = f"`per` must be 'vertex' or 'triangle', got {per!r}"
        raise ParameterError(msg)
    shape = tuple(colours.shape)
    if shape == (3,):
        return None
    if shape == (vertices, 3) and per != "triangle":
        return "vertex"
    if shape == (triangles, 3) and per != "vertex":
        return "triangle"
    msg = f"`colours` must have shape (3,), ({vertices}, 3) or ({triangles}, 3), got {shape}"
    raise ParameterError(msg)

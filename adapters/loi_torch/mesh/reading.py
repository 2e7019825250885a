"""Meshes from files, read by trimesh."""

from __future__ import annotations

import io
import pathlib
import warnings
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import trimesh

from loi_core.errors import MeshError
from loi_core.io.files import read_bytes
from loi_core.pixels.encoding import decode_srgb
from loi_core.support.wording import described, shown
from loi_torch.mesh.meshes import Mesh, MeshWarning
from loi_torch.mesh.topology import weld_vertices

__all__ = ["MESH_SUFFIXES", "read_mesh", "read_meshes"]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
MAX_FILE_BYTES: Final = 2**29
LINEAR_SUFFIXES: Final = (".glb", ".gltf")  # colours of vertices and materials are linear (glTF 2.0, section 3.9.2)


def read_mesh(path: pathlib.Path | str, *, side_files: bool = False, **options: Any) -> Mesh:
    """Read an OBJ, PLY, glTF, STL or OFF file as one mesh.

    Parameters
    ----------
    path : path or str
        All meshes of the file are merged; :func:`read_meshes` keeps them apart.
    side_files : bool
        Whether to open other files that the file names, such as the materials of an OBJ or the data of a glTF. They
        must lie in its folder or below.
    **options
        Of :class:`Mesh`. They replace the file's colours of vertices or triangles, texture coordinates, and base colour
        and texture of a material. Colours and textures are decoded from sRGB, except the colours of a glTF and of an
        OBJ's materials: these are linear, as Blender writes them. MTL has no rule, and three.js takes its `Kd` as sRGB.

    Returns
    -------
    Mesh

    Raises
    ------
    MeshError
        If the file cannot be read, has another format, or has no triangles.
    ParameterError
        If an option is not allowed.

    Warns
    -----
    MeshWarning
        If the file has several textures, which one mesh cannot hold; or if it names files that were not read.
    """
    path, geometries = _geometries(path, options, opens_files=side_files, by_object=False)
    return _mesh(path, [geometry for _, geometry in geometries], options)


def read_meshes(path: pathlib.Path | str, *, side_files: bool = False, **options: Any) -> dict[str, Mesh]:
    """Read the objects of a file as meshes by name, for :class:`MeshRenderer`.

    Parameters
    ----------
    path, side_files
        As for :func:`read_mesh`.
    **options
        Of :class:`Mesh`, for all meshes.

    Returns
    -------
    dict of Mesh
        By the names of objects, in which dots become underscores. An object of several materials is several meshes,
        with the names of the materials behind its own.

    Raises
    ------
    MeshError, ParameterError
        As for :func:`read_mesh`.
    """
    path, geometries = _geometries(path, options, opens_files=side_files, by_object=True)
    return {name: _mesh(path, [geometry], options) for name, geometry in _by_unique_name(geometries).items()}


def _mesh(path: pathlib.Path, geometries: list[Any], options: Mapping[str, Any]) -> Mesh:
    vertices = np.concatenate([geometry.vertices for geometry in geometries])
    first = np.append(0, np.cumsum([len(geometry.vertices) for geometry in geometries]))
    faces = np.concatenate([geometry.faces + offset for geometry, offset in zip(geometries, first, strict=False)])
    if path.suffix.lower() == ".stl":  # which stores the corners of each triangle separately
        welds = weld_vertices(np.asarray(vertices, dtype=np.float64))
        _, first_of_weld = np.unique(welds, return_index=True)
        vertices, faces = vertices[first_of_weld], welds[faces]
    return Mesh(vertices, faces, **{**_appearance(path, geometries, options), **options})


def _geometries(
    path: Any, options: Mapping[str, Any], *, opens_files: bool, by_object: bool
) -> tuple[pathlib.Path, list[tuple[str, Any]]]:
    """Return the path, and trimesh's meshes in world space with their names; warn of named files that were not read."""
    if not isinstance(path, pathlib.Path | str):
        msg = f"`path` must be a path, got {shown(path)}"
        raise MeshError(msg)
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        msg = f"{path}: a mesh must be one of {', '.join(MESH_SUFFIXES)}"
        raise MeshError(msg)
    named_files = NamedFiles(path.parent, opens_files=opens_files)
    settings: dict[str, Any] = {"split_objects": True} if by_object and suffix == ".obj" else {}
    settings |= {"process": False, "allow_remote": False, "resolver": named_files}
    try:
        content = io.BytesIO(read_bytes(path, MAX_FILE_BYTES))
        scene = trimesh.load_scene(content, file_type=suffix[1:], **settings)
        geometries = _in_world_space(scene)
    except OSError as error:
        msg = f"{path}: {described(error)}"
        raise MeshError(msg) from error
    except Exception as error:  # trimesh raises whatever its parsers raise
        msg = f"{path}: cannot be read as a mesh: {described(error)}"
        raise MeshError(msg) from error
    if not geometries:
        msg = f"{path}: has no triangles"
        raise MeshError(msg)
    if named_files.unread and not {"colours", "texture"} & set(options):
        hint = "" if opens_files else "; side_files=True opens them"
        msg = f"{path}: names files that were not read: {', '.join(map(shown, named_files.unread))}{hint}"
        warnings.warn(msg, MeshWarning, stacklevel=3)
    return path, geometries


def _in_world_space(scene: Any) -> list[tuple[str, Any]]:
    geometries = []
    for node in sorted(scene.graph.nodes_geometry):
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            geometries.append((node, geometry.copy().apply_transform(transform)))
    return geometries


def _by_unique_name(geometries: list[tuple[str, Any]]) -> dict[str, Any]:
    # trimesh appends the material to the name of an OBJ's object, to distinguish the parts of the object.
    materials = [str(getattr(getattr(geometry.visual, "material", None), "name", None)) for _, geometry in geometries]
    shorter = [name.removesuffix(f"_{material}") for (name, _), material in zip(geometries, materials, strict=True)]
    named: dict[str, Any] = {}
    for (name, geometry), short in zip(geometries, shorter, strict=True):
        unique = base = (short if shorter.count(short) == 1 else name).replace(".", "_")
        number = 1
        while unique in named:
            number += 1
            unique = f"{base}_{number}"
        named[unique] = geometry
    return named


class NamedFiles(trimesh.resolvers.Resolver):
    """The files that a mesh file names: read from its folder if `opens_files`, and otherwise listed in `unread`."""

    def __init__(self, folder: pathlib.Path, *, opens_files: bool) -> None:
        self._folder, self._opens_files = folder, opens_files
        self.unread: list[str] = []

    def get(self, name: str) -> bytes:
        """Return the content of a file; OSError if it is refused, missing, outside the folder or too large."""
        path = self._folder / str(name)
        try:
            if not self._opens_files or not path.resolve().is_relative_to(self._folder.resolve()):
                msg = f"{name} is not opened"
                raise OSError(msg)
            return read_bytes(path, MAX_FILE_BYTES)
        except (OSError, ValueError):
            self.unread.append(str(name))
            raise

    def keys(self) -> list[str]:
        """Return no names: a search in the folder would open files that are not named."""
        return []

    def write(self, name: str, data: Any) -> None:  # noqa: ARG002
        """Refuse to write."""
        raise OSError(name)

    def namespaced(self, namespace: str) -> NamedFiles:  # noqa: ARG002
        """Return this resolver."""
        return self


def _appearance(path: pathlib.Path, geometries: list[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the colours and textures that all geometries have, as options of :class:`Mesh`."""
    visual_kinds = {geometry.visual.kind for geometry in geometries}
    if visual_kinds == {"vertex"}:
        colours = np.concatenate([geometry.visual.vertex_colors[:, :3] for geometry in geometries]) / 255.0
        is_linear = path.suffix.lower() in LINEAR_SUFFIXES
        return {"colours": colours if is_linear else decode_srgb(colours), "per": "vertex"}
    if visual_kinds == {"face"}:
        colours = np.concatenate([geometry.visual.face_colors[:, :3] for geometry in geometries]) / 255.0
        return {"colours": decode_srgb(colours), "per": "triangle"}
    return _textured_appearance(path, geometries, options) if visual_kinds == {"texture"} else {}


def _textured_appearance(path: pathlib.Path, geometries: list[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    appearance: dict[str, Any] = {}
    single = len(geometries) == 1
    factors = [_base_colour(geometry.visual.material) for geometry in geometries]
    if any(factor is not None for factor in factors) and "colours" not in options:
        colours = [np.ones(3) if factor is None else factor for factor in factors]
        if single:
            appearance["colours"] = colours[0]
        else:
            rows = [np.tile(c, (len(geometry.faces), 1)) for c, geometry in zip(colours, geometries, strict=True)]
            appearance |= {"colours": np.concatenate(rows), "per": "triangle"}
    images = [_texture(geometry.visual.material) for geometry in geometries]
    has_uv = all(geometry.visual.uv is not None for geometry in geometries)
    image = images[0] if single else None
    if has_uv and ("texture" in options or image is not None):
        appearance["uv"] = np.concatenate([geometry.visual.uv for geometry in geometries])
    if has_uv and image is not None:
        appearance["texture"] = decode_srgb(np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0)
    elif any(item is not None for item in images) and not {"texture", "colours"} & set(options):
        msg = f"{path}: has {len(geometries)} parts with separate textures, and a mesh has one; they are left out"
        warnings.warn(msg, MeshWarning, stacklevel=4)
    return appearance


def _texture(material: Any) -> Any:
    """Return the picture of a glTF's or an OBJ's material, or None."""
    return getattr(material, "baseColorTexture", None) or getattr(material, "image", None)


def _base_colour(material: Any) -> Any:
    """Return the linear RGB factor of a material's texture, or None for white."""
    factor = getattr(material, "baseColorFactor", None)
    if factor is not None:
        return np.asarray(factor, dtype=np.float64)[:3] / 255.0
    diffuse = (getattr(material, "kwargs", None) or {}).get("kd")
    return None if diffuse is None else np.asarray(diffuse, dtype=np.float64)[:3]

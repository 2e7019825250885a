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

__all__ = ["MESH_SUFFIXES", "read_mesh"]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
MAX_FILE_BYTES: Final = 2**29
LINEAR_SUFFIXES: Final = (".glb", ".gltf")  # colours of vertices and materials are linear (glTF 2.0, section 3.9.2)


def read_mesh(path: pathlib.Path | str, **options: Any) -> Mesh:
    """Read an OBJ, PLY, glTF, STL or OFF file as one mesh.

    Parameters
    ----------
    path : path or str
        All meshes of the file are merged. No other file is opened: pass the materials and textures of an OBJ as
        `options`; a glTF must contain all its data, as a GLB does.
    **options
        Of :class:`Mesh`. They replace the file's colours of vertices or triangles, texture coordinates, and base colour
        and texture of a GLB. Colours and textures are decoded from sRGB, except the colours of a glTF, which are
        linear.

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
        If the file has several textures, which one mesh cannot hold.
    """
    if not isinstance(path, pathlib.Path | str):
        msg = f"`path` must be a path, got {shown(path)}"
        raise MeshError(msg)
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        msg = f"{path}: a mesh must be one of {', '.join(MESH_SUFFIXES)}"
        raise MeshError(msg)
    try:
        content = io.BytesIO(read_bytes(path, MAX_FILE_BYTES))
        scene = trimesh.load_scene(content, file_type=suffix[1:], process=False, allow_remote=False)
        geometries = [item for item in scene.dump() if isinstance(item, trimesh.Trimesh) and len(item.faces)]
    except OSError as error:
        msg = f"{path}: {described(error)}"
        raise MeshError(msg) from error
    except Exception as error:  # trimesh raises whatever its parsers raise
        msg = f"{path}: cannot be read as a mesh: {described(error)}"
        raise MeshError(msg) from error
    if not geometries:
        msg = f"{path}: has no triangles"
        raise MeshError(msg)
    vertices = np.concatenate([geometry.vertices for geometry in geometries])
    first = np.append(0, np.cumsum([len(geometry.vertices) for geometry in geometries]))
    faces = np.concatenate([geometry.faces + offset for geometry, offset in zip(geometries, first, strict=False)])
    if suffix == ".stl":  # which stores the corners of each triangle separately
        welds = weld_vertices(np.asarray(vertices, dtype=np.float64))
        _, first_of_weld = np.unique(welds, return_index=True)
        vertices, faces = vertices[first_of_weld], welds[faces]
    return Mesh(vertices, faces, **{**_appearance(path, geometries, options), **options})


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
    images = [getattr(geometry.visual.material, "baseColorTexture", None) for geometry in geometries]
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


def _base_colour(material: Any) -> Any:
    """Return the linear RGB factor of a glTF material's texture, or None for white."""
    factor = getattr(material, "baseColorFactor", None)
    return None if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255.0

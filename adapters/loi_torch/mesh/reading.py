"""Meshes from files, by trimesh."""

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
from loi_torch.mesh.topology import joined_corners

__all__ = ["MESH_SUFFIXES", "read_mesh"]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
MOST_BYTES: Final = 2**29
LINEAR: Final = (".glb", ".gltf")  # whose colours of vertices and materials are linear (glTF 2.0, section 3.9.2)


def read_mesh(path: pathlib.Path | str, **options: Any) -> Mesh:
    """A mesh from an OBJ, PLY, glTF, STL or OFF file.

    Parameters
    ----------
    path : path or str
        All meshes of the file become one. No other file is opened: materials and textures beside an OBJ are given by
        `options`, and a glTF has to hold all its data, as a GLB does.
    **options
        Of :class:`Mesh`, in place of what the file has: colours of vertices or triangles, texture coordinates, and the
        base colour and texture of a GLB. Colours are taken for sRGB and decoded, but those of a glTF, which are linear,
        as its texture is not.

    Warns
    -----
    MeshWarning
        If the file has textures that one mesh cannot hold.

    Raises
    ------
    MeshError
        If the file cannot be read, is none of these, or has no triangles.
    ParameterError
        If an option is not allowed.
    """
    if not isinstance(path, pathlib.Path | str):
        msg = f"`path` must be a path, got {shown(path)}"
        raise MeshError(msg)
    path = pathlib.Path(path)
    kind = path.suffix.lower()
    if kind not in MESH_SUFFIXES:
        msg = f"{path}: a mesh must be one of {', '.join(MESH_SUFFIXES)}"
        raise MeshError(msg)
    try:
        content = io.BytesIO(read_bytes(path, MOST_BYTES))
        loaded = trimesh.load_scene(content, file_type=kind[1:], process=False, allow_remote=False)
        parts = [one for one in loaded.dump() if isinstance(one, trimesh.Trimesh) and len(one.faces)]
    except OSError as error:
        msg = f"{path}: {described(error)}"
        raise MeshError(msg) from error
    except Exception as error:  # trimesh raises what its parsers meet
        msg = f"{path}: cannot be read as a mesh: {described(error)}"
        raise MeshError(msg) from error
    if not parts:
        msg = f"{path}: has no triangles"
        raise MeshError(msg)
    vertices = np.concatenate([one.vertices for one in parts])
    first = np.append(0, np.cumsum([len(one.vertices) for one in parts]))
    faces = np.concatenate([one.faces + start for one, start in zip(parts, first, strict=False)])
    if kind == ".stl":  # which stores each triangle's corners for itself
        places = joined_corners(np.asarray(vertices, dtype=np.float64))
        _, first_of = np.unique(places, return_index=True)
        vertices, faces = vertices[first_of], places[faces]
    return Mesh(vertices, faces, **{**_looks(path, parts, options), **options})


def _looks(path: pathlib.Path, parts: list[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Colours and textures that all parts have."""
    kinds = {one.visual.kind for one in parts}
    if kinds == {"vertex"}:
        coloured = np.concatenate([one.visual.vertex_colors[:, :3] for one in parts]) / 255.0
        linear = path.suffix.lower() in LINEAR
        return {"colours": coloured if linear else decode_srgb(coloured), "per": "vertex"}
    if kinds == {"face"}:
        coloured = np.concatenate([one.visual.face_colors[:, :3] for one in parts]) / 255.0
        return {"colours": decode_srgb(coloured), "per": "triangle"}
    looks: dict[str, Any] = {}
    if kinds == {"texture"}:
        factors = [_factor(one.visual.material) for one in parts]
        if any(one is not None for one in factors) and "colours" not in options:
            plain = [np.ones(3) if one is None else one for one in factors]
            rows = [np.tile(one, (len(part.faces), 1)) for one, part in zip(plain, parts, strict=True)]
            looks |= {"colours": plain[0]} if len(parts) == 1 else {"colours": np.concatenate(rows), "per": "triangle"}
        images = [getattr(one.visual.material, "baseColorTexture", None) for one in parts]
        mapped = all(one.visual.uv is not None for one in parts)
        if mapped and ("texture" in options or (len(parts) == 1 and images[0] is not None)):
            looks["uv"] = np.concatenate([one.visual.uv for one in parts])
        if mapped and len(parts) == 1 and images[0] is not None:
            looks["texture"] = decode_srgb(np.asarray(images[0].convert("RGB"), dtype=np.float64) / 255.0)
        elif any(one is not None for one in images) and not {"texture", "colours"} & set(options):
            msg = (
                f"{path}: has {len(parts)} parts with textures of their own, of which a mesh has one; they are left out"
            )
            warnings.warn(msg, MeshWarning, stacklevel=3)
    return looks


def _factor(material: Any) -> Any:
    """The colour that a glTF's material multiplies its texture by, linear RGB; None for white."""
    factor = getattr(material, "baseColorFactor", None)
    return None if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255.0

"""Meshes from files, by trimesh."""

from __future__ import annotations

import io
import pathlib
from typing import Any, Final

import numpy as np
import trimesh

from loi_core.errors import MeshError
from loi_core.io.files import read_bytes
from loi_core.pixels.encoding import decode_srgb
from loi_core.support.wording import described
from loi_torch.mesh.meshes import Mesh

__all__ = ["MESH_SUFFIXES", "read_mesh"]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
MOST_BYTES: Final = 2**29


def read_mesh(path: pathlib.Path | str, **options: Any) -> Mesh:
    """A mesh from an OBJ, PLY, glTF, STL or OFF file.

    Parameters
    ----------
    path : path or str
        All meshes of the file become one. No other file is opened: materials and textures beside an OBJ are given by
        `options`, and a glTF has to hold all its data, as a GLB does.
    **options
        Of :class:`Mesh`, in place of what the file has: vertex colours, texture coordinates, and the base texture of a
        GLB, which are taken for sRGB and decoded.

    Raises
    ------
    MeshError
        If the file cannot be read, is none of these, or has no triangles.
    ParameterError
        If an option is not allowed.
    """
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
    return Mesh(vertices, faces, **{**_looks(parts, "texture" in options), **options})


def _looks(parts: list[Any], textured: bool) -> dict[str, Any]:  # noqa: FBT001  # private
    """Colours and textures that all parts have."""
    looks: dict[str, Any] = {}
    kinds = {one.visual.kind for one in parts}
    if kinds == {"vertex"}:
        coloured = np.concatenate([one.visual.vertex_colors[:, :3] for one in parts]) / 255.0
        looks |= {"colours": decode_srgb(coloured), "per": "vertex"}
    if kinds == {"texture"} and all(one.visual.uv is not None for one in parts):
        image = getattr(parts[0].visual.material, "baseColorTexture", None) if len(parts) == 1 else None
        if textured or image is not None:
            looks["uv"] = np.concatenate([one.visual.uv for one in parts])
        if image is not None:
            looks["texture"] = decode_srgb(np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0)
    return looks

"""Cameras of glTF files."""

from __future__ import annotations

import json
import math
import pathlib
import struct
from typing import Any, Final

import numpy as np

from loi_core.errors import MeshError
from loi_core.io.files import read_bytes
from loi_core.support.wording import described, shown
from loi_torch.mesh.cameras import Camera

__all__ = ["read_cameras"]

MAX_FILE_BYTES: Final = 2**29
GLB_HEADER: Final = struct.Struct("<4sIIII")  # magic number, version, length; length and kind of the first chunk


def read_cameras(path: pathlib.Path | str) -> dict[str, Camera]:
    """Read the cameras of a glTF or GLB file, for images of any aspect.

    Parameters
    ----------
    path : path or str
        No other file is opened.

    Returns
    -------
    dict of Camera
        By the names of their nodes, in which dots become underscores; empty if the file has none.

    Raises
    ------
    MeshError
        If the file cannot be read, or one of its cameras is not valid.
    """
    if not isinstance(path, pathlib.Path | str):
        msg = f"`path` must be a path, got {shown(path)}"
        raise MeshError(msg)
    path = pathlib.Path(path)
    try:
        content = read_bytes(path, MAX_FILE_BYTES)
        if content.startswith(b"glTF"):
            length = GLB_HEADER.unpack_from(content)[3]
            content = content[GLB_HEADER.size : GLB_HEADER.size + length]
        with np.errstate(all="ignore"):  # a Camera refuses numbers that are not finite
            return _cameras(json.loads(content))
    except OSError as error:
        msg = f"{path}: {described(error)}"
        raise MeshError(msg) from error
    except Exception as error:  # a damaged document fails anywhere
        msg = f"{path}: its cameras cannot be read as glTF: {described(error)}"
        raise MeshError(msg) from error


def _cameras(document: dict[str, Any]) -> dict[str, Camera]:
    nodes = document.get("nodes", [])
    parents = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
    cameras: dict[str, Camera] = {}
    for index, node in enumerate(nodes):
        if "camera" not in node:
            continue
        to_world, ancestor, depth = np.eye(4), index, 0
        while True:
            to_world = _transform(nodes[ancestor]) @ to_world
            if ancestor not in parents:
                break
            ancestor, depth = parents[ancestor], depth + 1
            if depth > len(nodes):
                msg = "its nodes form a cycle"
                raise ValueError(msg)
        camera = document["cameras"][node["camera"]]
        name = str(node.get("name") or camera.get("name") or f"camera_{node['camera']}").replace(".", "_")
        if name in cameras:
            name = f"{name}_{index}"
        position, backward, up = to_world[:3, 3], to_world[:3, 2], to_world[:3, 1]
        length = float(np.linalg.norm(backward))  # a scale of the node has no effect
        backward = backward / (length or 1.0)
        if camera["type"] == "orthographic":
            lens = camera["orthographic"]
            options: dict[str, Any] = {"extent": 2.0 * lens["ymag"]}
        else:
            lens = camera["perspective"]
            options = {"fov": math.degrees(lens["yfov"])}
        cameras[name] = Camera(position, position - backward, up, near=lens["znear"], **options)
    return cameras


def _transform(node: dict[str, Any]) -> Any:
    """Return the matrix of a node into its parent's axes, shape (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", [1.0, 1.0, 1.0]), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return matrix

"""Descriptions of shapes, lights and cameras for ``mi.load_dict``, and a mesh, which needs Mitsuba's variant."""

from __future__ import annotations

from typing import Any, Final

import loi_mitsuba  # noqa: F401 - before Dr.Jit, so that it gets an LLVM that works

# isort: split
import mitsuba as mi
import numpy as np

__all__ = [
    "GREY",
    "ball",
    "bitmap",
    "camera",
    "colour",
    "diffuse",
    "floor",
    "lamp",
    "mesh_of_boxes",
    "numbers",
    "picture",
]

GREY: Final = [0.5, 0.4, 0.3]


def numbers(*values: float) -> Any:
    """Return a number or a vector as a float32 parameter."""
    return np.array(values if len(values) > 1 else values[0], dtype=np.float32)


def camera(width: int, height: int, origin: list[float], target: list[float], fov: float = 45.0) -> dict[str, Any]:
    """Return a perspective camera with a box filter; `fov` is in degrees."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


def colour(value: list[float]) -> dict[str, Any]:
    """Return a linear RGB colour."""
    return {"type": "rgb", "value": value}


def diffuse(value: list[float]) -> dict[str, Any]:
    """Return a two-sided diffuse BSDF."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour(value)}}


def floor(size: float = 8.0) -> dict[str, Any]:
    """Return a grey square at height 0 with edges of 2 `size`."""
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(size)
    return {"type": "rectangle", "to_world": up, "bsdf": diffuse(GREY)}


def ball(centre: list[float], radius: float, **entries: Any) -> dict[str, Any]:
    """Return a sphere with further entries."""
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().translate(centre).scale(radius), **entries}


def lamp(centre: list[float], radius: float, radiance: float) -> dict[str, Any]:
    """Return a spherical area light."""
    return ball(centre, radius, emitter={"type": "area", "radiance": colour([radiance] * 3)})


def mesh_of_boxes(name: str, boxes: list[tuple[tuple[float, float, float], float]], colour: list[float]) -> Any:
    """Return a mesh of several boxes, given as (centre, half edge), with welded vertices."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.uint32)
    flat = mi.Properties()
    flat["face_normals"] = True
    flat["bsdf"] = mi.load_dict(diffuse(colour))
    mesh = mi.Mesh(name, 8 * len(boxes), 12 * len(boxes), props=flat)
    params = mi.traverse(mesh)
    positions = [corners * half + np.array(centre, np.float32) for centre, half in boxes]
    params["vertex_positions"] = mi.Float(np.concatenate(positions).ravel())
    params["faces"] = mi.UInt32(np.concatenate([faces + 8 * k for k in range(len(boxes))]).ravel())
    params.update()
    return mesh


def picture(height: int, width: int, seed: int) -> Any:
    """Return a smooth random image, shape (height, width, 3), float32 in 0.1 to 0.9."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.1, 0.9, (4, 6, 3))
    rows = np.linspace(0, 3, height)
    columns = np.linspace(0, 5, width)
    tall = np.stack([[np.interp(rows, range(4), coarse[:, k, c]) for k in range(6)] for c in range(3)], axis=-1)
    smooth = [[np.interp(columns, range(6), tall[:, r, c]) for r in range(height)] for c in range(3)]
    return np.moveaxis(np.array(smooth), 0, -1).astype(np.float32)


def bitmap(picture: Any) -> dict[str, Any]:
    """Return a texture of linear values."""
    return {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True}

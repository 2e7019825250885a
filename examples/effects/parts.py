"""What the scenes are made of: dicts for ``mi.load_dict``, and a mesh. Mitsuba's variant has to be set before."""

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
    """A number, or a vector, as a parameter: float32."""
    return np.array(values if len(values) > 1 else values[0], dtype=np.float32)


def camera(width: int, height: int, origin: list[float], target: list[float], fov: float = 45.0) -> dict[str, Any]:
    """A perspective camera whose film has a box filter; `fov` in degrees."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


def colour(value: list[float]) -> dict[str, Any]:
    """A colour, linear RGB."""
    return {"type": "rgb", "value": value}


def diffuse(value: list[float]) -> dict[str, Any]:
    """A diffuse surface, seen from both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour(value)}}


def floor(size: float = 8.0) -> dict[str, Any]:
    """A grey square at height 0, half its edge `size` long."""
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(size)
    return {"type": "rectangle", "to_world": up, "bsdf": diffuse(GREY)}


def ball(place: list[float], radius: float, **more: Any) -> dict[str, Any]:
    """A sphere, with `more` of its entries."""
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().translate(place).scale(radius), **more}


def lamp(place: list[float], radius: float, radiance: float) -> dict[str, Any]:
    """A sphere that shines alike in all directions."""
    return ball(place, radius, emitter={"type": "area", "radiance": colour([radiance] * 3)})


def mesh_of_boxes(name: str, boxes: list[tuple[tuple[float, float, float], float]], colour: list[float]) -> Any:
    """One mesh of several boxes, (centre, half the edge) each, whose vertices are shared by their faces."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))], np.uint32)
    flat = mi.Properties()
    flat["face_normals"] = True
    flat["bsdf"] = mi.load_dict(diffuse(colour))
    mesh = mi.Mesh(name, 8 * len(boxes), 12 * len(boxes), props=flat)
    params = mi.traverse(mesh)
    places = [corners * half + np.array(centre, np.float32) for centre, half in boxes]
    params["vertex_positions"] = mi.Float(np.concatenate(places).ravel())
    params["faces"] = mi.UInt32(np.concatenate([faces + 8 * k for k in range(len(boxes))]).ravel())
    params.update()
    return mesh


def picture(height: int, width: int, seed: int) -> Any:
    """A smooth random picture, shape (height, width, 3), float32 in 0.1 to 0.9."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.1, 0.9, (4, 6, 3))
    rows = np.linspace(0, 3, height)
    columns = np.linspace(0, 5, width)
    tall = np.stack([[np.interp(rows, range(4), coarse[:, k, c]) for k in range(6)] for c in range(3)], axis=-1)
    smooth = [[np.interp(columns, range(6), tall[:, r, c]) for r in range(height)] for c in range(3)]
    return np.moveaxis(np.array(smooth), 0, -1).astype(np.float32)


def bitmap(picture: Any) -> dict[str, Any]:
    """A texture of a picture, which is not taken for sRGB."""
    return {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True}

"""Small scenes for the tests."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from loi_mitsuba import Rotate, Scale, Translate
from tests.helpers import Host

WIDTH, HEIGHT = 64, 48

# Parameters of the scene below, with a box: one of each kind.
PARAMETERS: dict[str, Any] = {
    "place": Translate("ball"),
    "size": Scale("ball"),
    "turn": Rotate("box", (0, 1, 0)),
    "floor": "floor.bsdf.reflectance.value",
    "light": "lamp.emitter.radiance.value",
}


def random_cotangent(seed: int = 0) -> Host:
    """A cotangent of an image of this size, as of a loss."""
    return np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, 3)).astype(np.float32)


def shadow_scene(**changes: Any) -> dict[str, Any]:
    """A floor with the shadow of a ball that is out of view, after the paper's figure of a shadow."""
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": transform().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": transform().rotate([1, 0, 0], -90).scale(8),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}},
        },
        "ball": {"type": "sphere", "to_world": transform().translate([0, 5, 0]).scale(0.4)},
        "lamp": {
            "type": "sphere",
            "to_world": transform().translate([0, 12, 0]).scale(0.7),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 100.0}},
        },
        **changes,
    }


def box(centre: tuple[float, float, float], half: float) -> Any:
    """A welded mesh of a box with flat shading."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.uint32)
    flat = mi.Properties()
    flat["face_normals"] = True
    mesh = mi.Mesh("box", 8, 12, props=flat)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float((corners * half + np.array(centre, np.float32)).ravel())
    params["faces"] = mi.UInt32(faces.ravel())
    params.update()
    return mesh

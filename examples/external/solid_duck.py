"""A duck on a wooden floor in Mitsuba, whose place, turn and size are free."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.convergence.solid import scene_on_floor
from examples.external.problem import Problem, Start, needs
from examples.external.solid_turns import host
from loi_core import Free
from loi_core.support.arrays import to_numpy

__all__ = ["DUCKS"]

SAMPLES: Final = 32
TARGET_SAMPLES: Final = 256
TARGET_SEED: Final = 10**6
HALF_SIZE: Final = 0.7  # on a floor of 8 by 8
TURN_DEGREES: Final = 25.0
SIZE: Final = 1.2
ALLOWED: Final = {"place": 0.06, "turn": 1.0, "size": 0.06}  # a pixel, a degree, and a pixel at the outline


def _duck() -> dict[str, Any]:
    """Return the duck of deodr, which stands on the floor and looks aside."""
    import deodr
    import mitsuba as mi

    path = str(Path(deodr.__file__).parent / "data" / "duck.obj")
    mesh = mi.load_dict({"type": "obj", "filename": path})
    vertices = np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    below = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    pose = mi.ScalarTransform4f().rotate([1, 0, 0], 90).scale(HALF_SIZE / (0.5 * float(np.max(high - low))))
    yellow = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.65, 0.1]}}
    return {"type": "obj", "filename": path, "to_world": pose.translate((-below).tolist()), "bsdf": yellow}


def _make(seed: int) -> Start:
    import loi_mitsuba

    scene = scene_on_floor("wood", "")
    scene["duck"] = _duck()
    handles: dict[str, Any] = {
        "place": loi_mitsuba.Translate("duck"),
        "turn": loi_mitsuba.Rotate("duck", (0, 0, 1)),
        "size": loi_mitsuba.Scale("duck"),
    }
    sign = 1.0 - 2.0 * (seed % 2)
    goal = {"place": np.array([0.9, 0.6, 0.0]), "turn": np.array(sign * TURN_DEGREES), "size": np.array(SIZE)}
    free = {
        "place": Free([-0.9, -0.5, 0.0], [-2.4, -2.4, 0.0], [2.4, 2.4, 0.0]),
        "turn": Free(float(goal["turn"] - sign * 40.0), -90.0, 90.0),
        "size": Free(0.75 * SIZE, 0.5, 2.0),
    }
    clean = loi_mitsuba.PlannedRenderer(scene, handles, spp=TARGET_SAMPLES).unabridged
    single = {name: value.astype(np.float32) for name, value in goal.items()}
    target = to_numpy(clean.render(clean.parameters() | single, seed=TARGET_SEED + seed))

    def error(params: Mapping[str, Any]) -> float:
        offsets = {name: np.linalg.norm(np.ravel(host(params[name]) - value)) for name, value in goal.items()}
        return float(max(offsets[name] / ALLOWED[name] for name in goal))

    return Start(loi_mitsuba.PlannedRenderer(scene, handles, spp=SAMPLES), target, free, error)


DUCKS: Final = (
    Problem(
        "duck with turn and size",
        _make,
        "tolerances",
        1.0,
        steps=120,
        renders=250,
        starts=3,
        source="users of the library, with Mitsuba 3 and the duck of deodr",
        licence="no file is copied",
        missing=needs("mitsuba", "deodr"),
    ),
)

"""Two mirrors that meet at an edge, and coloured beads at the far end, seen along the edge.

Unknown are the angles of both mirrors, and so how the kaleidoscope is turned and how many images it makes, and where
the beads are. The light is that of the sky, through the near end and from what the mirrors show of it, and of a dim
plate behind the beads.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

from examples.paper.variational.problem import Group, Images, Problem, as_arrays
from loi_core.renderers.poses import ParameterTarget
from loi_mitsuba import Rotate, Translate  # before mitsuba

# isort: split
import mitsuba as mi

__all__ = ["problem", "scene"]

LENGTH: Final = 6.0  # of the mirrors, along the edge
HEIGHT: Final = 4.0  # across it
BEAD: Final = 0.28  # radius
DEPTH: Final = 6  # of a path; two reflections on each side of an edge of 90 degrees show all there is
COLOURS: Final = {
    "red": (0.9, 0.05, 0.05),
    "green": (0.05, 0.8, 0.1),
    "blue": (0.1, 0.15, 0.95),
}
PLACES: Final = {"red": (-0.5, 1.0), "green": (0.6, 1.3), "blue": (-0.2, 1.8)}
ANGLES: Final = {"left": 3.0, "right": -2.0}  # degrees
OPENING: Final = {"left": 135.0, "right": 45.0}  # degrees, where the angles are 0
TURN: Final = 12.0  # degrees either way
ACROSS: Final = (-1.0, 1.0)  # the range of a bead
ALONG: Final = (0.7, 2.2)
MANY: Final = 64  # samples of the target


def scene(side: int) -> dict[str, Any]:
    """The scene, for ``mi.load_dict``, with every bead on the edge."""
    place = mi.ScalarTransform4f

    def mirror(angle: float) -> dict[str, Any]:
        upright = place().translate([HEIGHT / 2.0, 0.0, -LENGTH / 2.0]).rotate([1, 0, 0], 90)
        silver = {
            "type": "conductor",
            "material": "none",
            "specular_reflectance": {"type": "rgb", "value": 0.92},
        }
        return {
            "type": "rectangle",
            "to_world": place().rotate([0, 0, 1], angle) @ upright.scale([HEIGHT / 2.0, LENGTH / 2.0, 1.0]),
            "bsdf": {"type": "twosided", "silver": silver},
        }

    def bead(colour: tuple[float, float, float]) -> dict[str, Any]:
        return {
            "type": "sphere",
            "center": [0.0, 0.0, -LENGTH],
            "radius": BEAD,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}},
        }

    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "sensor": {
            "type": "perspective",
            "fov": 40.0,
            "to_world": place().look_at([0, 0.35, 0.5], [0, 0.35, -LENGTH], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}},
        },
        **{name: mirror(angle) for name, angle in OPENING.items()},
        "plate": {
            "type": "rectangle",
            "to_world": place().translate([0, 0, -LENGTH - 0.3]).scale(6),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.15}},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.5}},
        **{name: bead(colour) for name, colour in COLOURS.items()},
    }


@lru_cache(maxsize=2)
def problem(side: int, samples: int) -> Problem:
    """The kaleidoscope at a size in pixels; its target is a render of the very same scene."""
    mi.set_variant("llvm_ad_rgb")
    targets: dict[str, ParameterTarget] = {name: Rotate(name, (0, 0, 1), (0, 0, 0)) for name in OPENING}
    truth: dict[str, float] = dict(ANGLES)
    low, high = dict.fromkeys(OPENING, -TURN), dict.fromkeys(OPENING, TURN)
    for name, at in PLACES.items():
        for axis, along, value, (least, most) in zip(
            ("x", "y"), ((1, 0, 0), (0, 1, 0)), at, (ACROSS, ALONG), strict=True
        ):
            key = f"{name} {axis}"
            targets[key] = Translate(name, along)
            truth[key], low[key], high[key] = value, least, most
    images, close = (Images(scene(side), targets, count) for count in (samples, MANY))
    target = close.render(as_arrays(truth), seed=10**6)
    beads = tuple(name for name in truth if name not in OPENING)
    # A reflection turns by twice the angle: 2 degrees move the image of the farthest bead by half of its radius.
    groups = (Group("beads, radii", beads, BEAD, 0.5), Group("mirrors, degrees", tuple(OPENING), 1.0, 2.0))
    return Problem(images, close, target, truth, low, high, groups)

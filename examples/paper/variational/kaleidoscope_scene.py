"""Two mirrors that meet at an edge, and coloured beads at the far end, viewed along the edge.

The unknowns are the angles of both mirrors, which determine the orientation of the kaleidoscope and the number of its
images, and the positions of the beads. A sky lights the scene through the near end, directly and by reflection in the
mirrors, and a dim plate glows behind the beads.
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

MIRROR_LENGTH: Final = 6.0  # along the edge
MIRROR_HEIGHT: Final = 4.0  # across the edge
BEAD_RADIUS: Final = 0.28
MAX_DEPTH: Final = 6  # of a path: two reflections on either side of an edge of 90 degrees show every image
COLOURS: Final = {
    "red": (0.9, 0.05, 0.05),
    "green": (0.05, 0.8, 0.1),
    "blue": (0.1, 0.15, 0.95),
}
BEAD_POSITIONS: Final = {"red": (-0.5, 1.0), "green": (0.6, 1.3), "blue": (-0.2, 1.8)}
ANGLES: Final = {"left": 3.0, "right": -2.0}  # degrees
REST_ANGLES: Final = {"left": 135.0, "right": 45.0}  # degrees, where the angles are 0
MAX_ANGLE: Final = 12.0  # degrees in either direction
BEAD_RANGE_X: Final = (-1.0, 1.0)
BEAD_RANGE_Y: Final = (0.7, 2.2)
TARGET_SAMPLES: Final = 64


def scene(side_px: int) -> dict[str, Any]:
    """Return the scene for ``mi.load_dict``, with every bead on the edge."""
    transform = mi.ScalarTransform4f

    def mirror(angle: float) -> dict[str, Any]:
        upright = transform().translate([MIRROR_HEIGHT / 2.0, 0.0, -MIRROR_LENGTH / 2.0]).rotate([1, 0, 0], 90)
        silver = {
            "type": "conductor",
            "material": "none",
            "specular_reflectance": {"type": "rgb", "value": 0.92},
        }
        return {
            "type": "rectangle",
            "to_world": transform().rotate([0, 0, 1], angle)
            @ upright.scale([MIRROR_HEIGHT / 2.0, MIRROR_LENGTH / 2.0, 1.0]),
            "bsdf": {"type": "twosided", "silver": silver},
        }

    def bead(colour: tuple[float, float, float]) -> dict[str, Any]:
        return {
            "type": "sphere",
            "center": [0.0, 0.0, -MIRROR_LENGTH],
            "radius": BEAD_RADIUS,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}},
        }

    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH},
        "sensor": {
            "type": "perspective",
            "fov": 40.0,
            "to_world": transform().look_at([0, 0.35, 0.5], [0, 0.35, -MIRROR_LENGTH], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": side_px, "height": side_px, "rfilter": {"type": "box"}},
        },
        **{name: mirror(angle) for name, angle in REST_ANGLES.items()},
        "plate": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -MIRROR_LENGTH - 0.3]).scale(6),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.15}},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.5}},
        **{name: bead(colour) for name, colour in COLOURS.items()},
    }


@lru_cache(maxsize=2)
def problem(side_px: int, samples: int) -> Problem:
    """Return the kaleidoscope at a size in pixels, with a render of the same scene as target."""
    mi.set_variant("llvm_ad_rgb")
    targets: dict[str, ParameterTarget] = {name: Rotate(name, (0, 0, 1), (0, 0, 0)) for name in REST_ANGLES}
    truth: dict[str, float] = dict(ANGLES)
    lower, upper = dict.fromkeys(REST_ANGLES, -MAX_ANGLE), dict.fromkeys(REST_ANGLES, MAX_ANGLE)
    axes = (("x", (1, 0, 0), BEAD_RANGE_X), ("y", (0, 1, 0), BEAD_RANGE_Y))
    for name, position in BEAD_POSITIONS.items():
        for (axis, direction, bounds), coordinate in zip(axes, position, strict=True):
            key = f"{name} {axis}"
            targets[key] = Translate(name, direction)
            truth[key], (lower[key], upper[key]) = coordinate, bounds
    images, reference_images = (Images(scene(side_px), targets, count) for count in (samples, TARGET_SAMPLES))
    target = reference_images.render(as_arrays(truth), seed=10**6)
    beads = tuple(name for name in truth if name not in REST_ANGLES)
    # A reflection turns by twice the angle: 2 degrees move the image of the farthest bead by half of its radius.
    groups = (
        Group("beads, radii", beads, BEAD_RADIUS, 0.5),
        Group("mirrors, degrees", tuple(REST_ANGLES), 1.0, 2.0),
    )
    return Problem(images, reference_images, target, truth, lower, upper, groups)

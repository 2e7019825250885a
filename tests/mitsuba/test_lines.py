"""Lines along which jumps of brightness are searched for count all that they cross, however narrow."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba.boundary.segments import SegmentSampler

PLACE = mi.ScalarTransform4f
SIZE = 16
SAMPLES = 256
LEAN = 45.0  # degrees


def ridge(width: float) -> tuple[mi.Scene, SegmentSampler]:
    """A strip that faces the camera, so many pixels wide, between two walls that lean away from it."""
    half = width / SIZE  # of the view at the strip, which is 2 wide
    shapes = {"strip": {"type": "rectangle", "to_world": PLACE().scale([half, 100.0, 1.0])}}
    for name, side in (("left", -1.0), ("right", 1.0)):
        lean = PLACE().translate([side * half, 0.0, 0.0]).rotate([0, 1, 0], side * LEAN)
        shapes[name] = {
            "type": "rectangle",
            "to_world": lean.translate([side * 50.0, 0.0, 0.0]).scale([50.0, 100.0, 1.0]),
        }
    camera = {
        "type": "perspective",
        "fov": 2.0 * np.degrees(np.arctan(0.1)),
        "to_world": PLACE().look_at([0, 0, 10], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE},
    }
    scene = mi.load_dict({"type": "scene", "camera": camera, **shapes})
    return scene, SegmentSampler(scene.sensors()[0])


@pytest.mark.parametrize("width", [3.0, 0.7, 0.3])
def test_both_sides_of_what_is_narrower_than_a_pixel_are_crossed(width: float) -> None:
    """As often as lines go over them; where it is looked at the ends of whole lines, of 0.3 pixels 30 % of them are."""
    scene, lines = ridge(width)
    first, second, along = lines.drawn(scene, SAMPLES, seed=0)
    changes = (lines.seen(scene, first) != lines.seen(scene, second)) & (along.x > 0.5)
    number = lines.number(SAMPLES)
    wanted = 2 * (SIZE + 1) * number
    assert dr.count(changes)[0] == pytest.approx(wanted, abs=4.0 * np.sqrt(wanted))


@pytest.mark.parametrize("width", [3.0, 0.3])
def test_lines_in_pieces_are_as_long_as_whole_ones(width: float) -> None:
    scene, lines = ridge(width)
    first, second, along = lines.drawn(scene, SAMPLES, seed=1)
    length = np.sum(np.array(second - first) * np.array(along))
    assert length == pytest.approx(2 * (SIZE + 1) ** 2 * lines.number(SAMPLES), rel=1e-5)

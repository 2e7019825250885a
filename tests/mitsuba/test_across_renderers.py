"""The same emitting disks, by Mitsuba and by the exact-area rasterizer: one image, one loss, one position gradient.

Mitsuba has no gradient of silhouettes in view for orthographic cameras, so a narrow perspective looks at the disks.
That costs nothing here: a disk parallel to the image plane projects to a disk exactly, and emits alike in all
directions, so every disk is placed and sized such that its projection is what an orthographic camera would see. What
is left is float32: :func:`test_the_camera_looks_at_pixels` measures 1e-6 pixels and allows 1e-4.

The rasterizer blends coverages, which is the exact area only where no pixel holds the edges of two disks. So the disk
on top lies well inside the one below, and the third apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from loi_core import LOIObjective
from loi_core.renderers import Disks
from loi_mitsuba import MitsubaRenderer, Translate
from tests.helpers import Host

WIDTH, HEIGHT = 32, 24
CENTRE = np.array([WIDTH / 2, HEIGHT / 2])
DISTANCE: Final = 500.0  # of the camera from the plane where a unit of the world is a pixel, in pixels

POSITIONS = np.array([[10.3, 12.4], [11.6, 10.9], [24.2, 8.7]])
RADII = np.array([7.3, 2.6, 4.1])
RADIANCES = np.array([[0.25, 0.6, 0.8], [0.9, 0.3, 0.15], [0.7, 0.5, 0.95]])
BACKGROUND = np.array([0.1, 0.15, 0.05])
NEARNESS = np.array([1.0, 0.98, 1.0])  # distance from the camera over DISTANCE; the second disk is in front
GOAL = POSITIONS + np.array([[4.0, 3.0], [-3.5, -4.5], [-4.2, 5.0]])  # no component of the gradient is near zero

SEEDS: Final = 32
SAMPLES: Final = 512  # per pixel and seed, of the image and of the gradient
FALSE_ALARM: Final = 1e-4  # of each test as a whole, over all that it compares; its seeds are fixed
LARGEST_ERROR: Final = 4e-3  # standard error of a gradient's component over the component
WRONG: Final = 0.02  # relative error of one component of the gradient that must be found


@dataclass(frozen=True)
class Exact:
    """What the rasterizer says, in float64 and without noise."""

    image: Host
    objective: LOIObjective
    loss: float
    cotangent: Host
    gradient: Host  # by the positions in pixels, shape (disks, 2)


@dataclass(frozen=True)
class Drawn:
    """What Mitsuba says, by seed."""

    images: Host  # shape (seeds, H, W, 3)
    gradients: Host  # by the positions in pixels, of the rasterizer's cotangent; shape (seeds, disks, 2)


def emitting_scene() -> dict[str, Any]:
    """x to the right and y down as in the image, and away from the camera z."""
    place = mi.ScalarTransform4f
    x, y = CENTRE.tolist()
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 2.0 * math.degrees(math.atan(WIDTH / 2 / DISTANCE)),
            "near_clip": 0.5 * DISTANCE,
            "far_clip": 2.0 * DISTANCE,
            "to_world": place().look_at([x, y, -DISTANCE], [x, y, 0.0], [0.0, -1.0, 0.0]),
            # A box filter makes a pixel the mean over its square, which is what the rasterizer computes.
            "film": {
                "type": "hdrfilm",
                "width": WIDTH,
                "height": HEIGHT,
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": BACKGROUND.tolist()}},
    }
    for index, near in enumerate(NEARNESS.tolist()):
        seen_at = (CENTRE + near * (POSITIONS[index] - CENTRE)).tolist()
        pose = place().translate([*seen_at, (near - 1.0) * DISTANCE]).rotate([1, 0, 0], 180)  # towards the camera
        scene[f"disk{index}"] = {
            "type": "disk",
            "to_world": pose.scale(near * float(RADII[index])),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},  # the sky must not add light
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": RADIANCES[index].tolist()}},
        }
    return scene


@pytest.fixture(scope="module")
def exact() -> Exact:
    disks = Disks(HEIGHT, WIDTH, POSITIONS, RADII, RADIANCES, BACKGROUND)
    params = disks.parameters()
    image, pullback = disks.render_vjp(params)
    objective = LOIObjective(disks.render({**params, "positions": GOAL}))
    loss, cotangent = objective.value_and_grad(image)
    return Exact(image, objective, float(loss), cotangent, pullback(cotangent)["positions"])


@pytest.fixture(scope="module")
def drawn(exact: Exact) -> Drawn:
    mi.set_variant("llvm_ad_rgb")  # before the fixture that does so for each test
    handles = {f"place{index}": Translate(f"disk{index}") for index in range(len(RADII))}
    renderer = MitsubaRenderer(emitting_scene(), handles, spp=SAMPLES)
    params = renderer.parameters()
    images, gradients = [], []
    for seed in range(SEEDS):
        image, pullback = renderer.render_vjp(params, seed=seed)
        # One fixed cotangent: the pullback is linear in it, so that the noise of the image cannot bias the gradient.
        by_world = pullback(exact.cotangent)
        images.append(image)
        gradients.append([by_world[name][:2] for name in handles])
    # A pixel is NEARNESS units of the world at a disk's depth.
    by_pixel = np.array(gradients, dtype=np.float64) * NEARNESS[:, None]
    return Drawn(np.array(images, dtype=np.float64), by_pixel)


def standard_error(draws: Host) -> Host:
    return np.asarray(draws.std(axis=0, ddof=1) / math.sqrt(len(draws)))


def scores(draws: Host, wanted: Host) -> Host:
    """How many of their own standard errors the means of `draws` are from `wanted`."""
    return np.asarray((draws.mean(axis=0) - wanted) / standard_error(draws))


def agree(draws: Host, wanted: Host) -> bool:
    """A two-sided t-test of every component, which together raise a false alarm with probability FALSE_ALARM."""
    critical = stats.t.isf(0.5 * FALSE_ALARM / wanted.size, len(draws) - 1)
    return bool(np.all(np.abs(scores(draws, wanted)) < critical))


def test_the_camera_looks_at_pixels() -> None:
    film = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT], *POSITIONS])
    sensor = mi.load_dict(emitting_scene()).sensors()[0]
    x, y = (film / [WIDTH, HEIGHT]).T
    ray = sensor.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(x), mi.Float(y)), mi.Point2f(0.5))[0]
    origin, direction = (np.array(value, dtype=np.float64).T for value in (ray.o, ray.d))
    met = origin - origin[:, 2:] / direction[:, 2:] * direction  # where the plane z = 0 is crossed
    # A direction in float32 is off by 6e-8 per operation, which DISTANCE makes 3e-5 pixels; there are a few.
    np.testing.assert_allclose(met[:, :2], film, rtol=0.0, atol=1e-4)


def test_both_show_the_same_image(exact: Exact, drawn: Drawn) -> None:
    colours = np.array([BACKGROUND, *RADIANCES])
    flat = np.any(np.all(np.abs(exact.image[:, :, None] - colours) < 1e-12, axis=-1), axis=-1)
    assert 0.5 < flat.mean() < 1.0
    # No noise without an edge, but each of the SAMPLES additions in float32 may round by 6e-8.
    assert np.max(np.abs(drawn.images[:, flat] - exact.image[flat])) < SAMPLES * 6e-8
    # Hoeffding's inequality: by how much the mean of independent samples from a range may miss what is expected.
    ends = np.ptp(colours, axis=0)
    count = exact.image[~flat].size
    allowed = ends * math.sqrt(math.log(2.0 * count / FALSE_ALARM) / (2.0 * SEEDS * SAMPLES))
    assert np.all(np.abs(drawn.images.mean(axis=0) - exact.image) < allowed)


def test_both_have_the_same_loss(exact: Exact, drawn: Drawn) -> None:
    losses = np.array([float(exact.objective.value_and_grad(image)[0]) for image in drawn.images])
    error = float(standard_error(losses))
    # The loss is not linear, so noise in the image biases it. How much shows in the loss of the mean image, which has
    # SEEDS times less of that bias: too little for the test to see.
    bias = losses.mean() - float(exact.objective.value_and_grad(drawn.images.mean(axis=0))[0])
    assert abs(bias) < 0.1 * error
    assert error < 5e-4 * exact.loss
    assert agree(losses, np.array(exact.loss))


def test_both_have_the_same_position_gradient(exact: Exact, drawn: Drawn) -> None:
    assert np.all(standard_error(drawn.gradients) < LARGEST_ERROR * np.abs(exact.gradient))
    assert agree(drawn.gradients, exact.gradient)


def test_a_gradient_that_is_wrong_by_two_percent_is_rejected(exact: Exact, drawn: Drawn) -> None:
    """In any one component, too large or too small: it moves by 11 standard errors or more, and 5.1 are allowed."""
    for disk, axis in np.ndindex(exact.gradient.shape):
        for factor in (1.0 - WRONG, 1.0 + WRONG):
            wrong = drawn.gradients.copy()
            wrong[:, disk, axis] *= factor
            assert not agree(wrong, exact.gradient)

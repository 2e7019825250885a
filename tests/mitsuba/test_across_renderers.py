"""Mitsuba and the exact-area rasteriser agree on emitting disks: in the image, the loss and the position gradient.

Mitsuba has no gradient of visible silhouettes for orthographic cameras, so the camera is a narrow perspective. This
is exact: a disk parallel to the image plane projects to a disk and emits equally in all directions, so each disk is
placed and scaled to project as for an orthographic camera. Only float32 errors remain:
:func:`test_the_camera_maps_the_plane_of_the_disks_to_pixels` measures 1e-6 pixels and allows 1e-4.

The rasteriser blends coverages, which equals the exact area only where no pixel contains edges of two disks. So the
top disk lies well inside the one below it, and the third disk lies apart.
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
DISTANCE: Final = 500.0  # pixels from the camera to the plane where a world unit is a pixel

POSITIONS = np.array([[10.3, 12.4], [11.6, 10.9], [24.2, 8.7]])
RADII = np.array([7.3, 2.6, 4.1])
RADIANCES = np.array([[0.25, 0.6, 0.8], [0.9, 0.3, 0.15], [0.7, 0.5, 0.95]])
BACKGROUND = np.array([0.1, 0.15, 0.05])
RELATIVE_DEPTH = np.array([1.0, 0.98, 1.0])  # distance from the camera over DISTANCE; the second disk is in front
GOAL = POSITIONS + np.array([[4.0, 3.0], [-3.5, -4.5], [-4.2, 5.0]])  # no component of the gradient is near zero

SEEDS: Final = 32
SPP: Final = 512  # per seed, of the image and of the gradient
FALSE_ALARM_RATE: Final = 1e-4  # of each test over all its comparisons; its seeds are fixed
MAX_STANDARD_ERROR: Final = 4e-3  # of a component of the gradient, relative to the component
DETECTABLE_ERROR: Final = 0.02  # relative error of one component of the gradient


@dataclass(frozen=True)
class Exact:
    """Results of the rasteriser, in float64 and without noise."""

    image: Host
    objective: LOIObjective
    loss: float
    cotangent: Host
    gradient: Host  # with respect to positions in pixels, shape (disks, 2)


@dataclass(frozen=True)
class Estimates:
    """Results of Mitsuba by seed."""

    images: Host  # shape (seeds, H, W, 3)
    gradients: Host  # of the rasteriser's cotangent, with respect to pixels; shape (seeds, disks, 2)


def emitting_scene() -> dict[str, Any]:
    """Disks in a frame with x to the right, y down as in the image, and z away from the camera."""
    transform = mi.ScalarTransform4f
    x, y = CENTRE.tolist()
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 2.0 * math.degrees(math.atan(WIDTH / 2 / DISTANCE)),
            "near_clip": 0.5 * DISTANCE,
            "far_clip": 2.0 * DISTANCE,
            "to_world": transform().look_at([x, y, -DISTANCE], [x, y, 0.0], [0.0, -1.0, 0.0]),
            # With a box filter, a pixel is the mean over its square, as in the rasteriser.
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
    for index, depth in enumerate(RELATIVE_DEPTH.tolist()):
        centre = (CENTRE + depth * (POSITIONS[index] - CENTRE)).tolist()
        pose = transform().translate([*centre, (depth - 1.0) * DISTANCE]).rotate([1, 0, 0], 180)  # faces the camera
        scene[f"disk{index}"] = {
            "type": "disk",
            "to_world": pose.scale(depth * float(RADII[index])),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},  # reflects no light of the sky
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
def estimates(exact: Exact) -> Estimates:
    mi.set_variant("llvm_ad_rgb")  # this fixture runs before the function-scoped one
    handles = {f"place{index}": Translate(f"disk{index}") for index in range(len(RADII))}
    # Neither reflected light nor shadows have a gradient here: black disks that emit, under a uniform sky.
    outlines = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": SPP, "sppi": 0}
    renderer = MitsubaRenderer(emitting_scene(), handles, integrator=outlines, spp=SPP)
    params = renderer.parameters()
    images, gradients = [], []
    for seed in range(SEEDS):
        image, pullback = renderer.render_vjp(params, seed=seed)
        # A fixed cotangent, so that the noise of the image does not bias the gradient.
        gradient = pullback(exact.cotangent)
        images.append(image)
        gradients.append([gradient[name][:2] for name in handles])
    # At the depth of a disk, a pixel is RELATIVE_DEPTH world units.
    per_pixel = np.array(gradients, dtype=np.float64) * RELATIVE_DEPTH[:, None]
    return Estimates(np.array(images, dtype=np.float64), per_pixel)


def standard_error(draws: Host) -> Host:
    return np.asarray(draws.std(axis=0, ddof=1) / math.sqrt(len(draws)))


def t_scores(draws: Host, expected: Host) -> Host:
    """Return the deviations of the means of `draws` from `expected` in standard errors."""
    return np.asarray((draws.mean(axis=0) - expected) / standard_error(draws))


def agree(draws: Host, expected: Host) -> bool:
    """Run two-sided t-tests of all components, with a joint false-alarm probability FALSE_ALARM_RATE."""
    critical = stats.t.isf(0.5 * FALSE_ALARM_RATE / expected.size, len(draws) - 1)
    return bool(np.all(np.abs(t_scores(draws, expected)) < critical))


def test_the_camera_maps_the_plane_of_the_disks_to_pixels() -> None:
    film = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT], *POSITIONS])
    sensor = mi.load_dict(emitting_scene()).sensors()[0]
    x, y = (film / [WIDTH, HEIGHT]).T
    ray = sensor.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(x), mi.Float(y)), mi.Point2f(0.5))[0]
    origin, direction = (np.array(value, dtype=np.float64).T for value in (ray.o, ray.d))
    hit = origin - origin[:, 2:] / direction[:, 2:] * direction  # with the plane z = 0
    # Each float32 operation on a direction errs by 6e-8, or 3e-5 pixels at DISTANCE, and there are a few.
    np.testing.assert_allclose(hit[:, :2], film, rtol=0.0, atol=1e-4)


def test_mitsuba_and_the_disk_rasteriser_have_the_same_image(exact: Exact, estimates: Estimates) -> None:
    colours = np.array([BACKGROUND, *RADIANCES])
    flat = np.any(np.all(np.abs(exact.image[:, :, None] - colours) < 1e-12, axis=-1), axis=-1)
    assert 0.5 < flat.mean() < 1.0
    # Pixels without an edge have no noise, but each of the SPP additions in float32 may round by 6e-8.
    assert np.max(np.abs(estimates.images[:, flat] - exact.image[flat])) < SPP * 6e-8
    # Hoeffding's inequality bounds the error of the mean of independent samples from a range.
    ranges = np.ptp(colours, axis=0)
    count = exact.image[~flat].size
    allowed = ranges * math.sqrt(math.log(2.0 * count / FALSE_ALARM_RATE) / (2.0 * SEEDS * SPP))
    assert np.all(np.abs(estimates.images.mean(axis=0) - exact.image) < allowed)


def test_mitsuba_and_the_disk_rasteriser_have_the_same_loss(exact: Exact, estimates: Estimates) -> None:
    losses = np.array([float(exact.objective.value_and_grad(image)[0]) for image in estimates.images])
    error = float(standard_error(losses))
    # The loss is not linear, so noise in the image biases it. The loss of the mean image has SEEDS times less bias,
    # too little for the test to detect, and thereby measures the bias.
    bias = losses.mean() - float(exact.objective.value_and_grad(estimates.images.mean(axis=0))[0])
    assert abs(bias) < 0.1 * error
    assert error < 5e-4 * exact.loss
    assert agree(losses, np.array(exact.loss))


def test_mitsuba_and_the_disk_rasteriser_have_the_same_position_gradient(exact: Exact, estimates: Estimates) -> None:
    assert np.all(standard_error(estimates.gradients) < MAX_STANDARD_ERROR * np.abs(exact.gradient))
    assert agree(estimates.gradients, exact.gradient)


def test_the_comparison_rejects_gradients_that_are_off_by_two_percent(exact: Exact, estimates: Estimates) -> None:
    """An error in any component shifts it by at least 11 standard errors, and 5.1 are allowed."""
    for disk, axis in np.ndindex(exact.gradient.shape):
        for factor in (1.0 - DETECTABLE_ERROR, 1.0 + DETECTABLE_ERROR):
            wrong = estimates.gradients.copy()
            wrong[:, disk, axis] *= factor
            assert not agree(wrong, exact.gradient)

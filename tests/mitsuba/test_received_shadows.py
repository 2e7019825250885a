"""Shadows that fall on moving shapes have a gradient, and light at grazing angles does not dominate it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, Translate
from mitsuba_boundaries.received_shadows import ReceivedShadowBoundary
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, box, shadow_scene
from tests.strategies import thorough

MOVES: dict[str, Any] = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
START = {name: np.float32(0.0) for name in MOVES}
STEP = 0.03
DIRECT = {"integrator": {"type": "direct"}}
SHADOWS = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 0, "sppi": 256}


def ball(x: float, y: float, z: float, radius: float) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, z], "radius": radius}


def shadowed_ball(scene_name: str) -> dict[str, Any]:
    scene = shadow_scene(**DIRECT, ball=ball(0.0, 1.2, 0.0, 0.9))
    if scene_name == "under the sky":
        del scene["lamp"]
        return scene | {"sky": {"type": "constant", "radiance": 0.8}, "other": ball(1.7, 1.4, 0.3, 0.9)}
    return scene | {"other": ball(0.3, 3.0, 0.3, 0.5)}


def mean_gradient(renderer: MitsubaRenderer, weight: Host, seeds: int) -> tuple[Host, Host]:
    """The mean gradient over seeds, and its standard error."""
    draws = np.array([list(renderer.vjp(START, weight, seed=seed).values()) for seed in range(seeds)])
    return draws.mean(axis=0), draws.std(axis=0, ddof=1) / np.sqrt(seeds)


@pytest.mark.parametrize("scene_name", [pytest.param("under a ball", marks=thorough), "under the sky"])
def test_a_shadowed_moving_ball_has_the_gradient_of_finite_differences(
    scene_name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = shadowed_ball(scene_name)
    renderer = MitsubaRenderer(scene, MOVES, spp=64)
    images = renderer.with_integrator("scene", spp=1024)
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((column - 40.0) ** 2 + (row - 18.0) ** 2) / 60.0).astype(np.float32)[..., None].repeat(3, axis=2)
    expected = []
    for name in MOVES:
        forward, backward = (images.render({**START, name: np.float32(step)}, seed=0) for step in (STEP, -STEP))
        expected.append(float(np.sum((forward - backward) * weight)) / (2.0 * STEP))
    gradient, error = mean_gradient(renderer, weight, 8)
    size = float(np.linalg.norm(expected))
    assert np.linalg.norm(error) < 0.1 * size
    assert np.linalg.norm(gradient - expected) < 0.05 * size + 3.0 * np.linalg.norm(error)

    monkeypatch.setattr(ReceivedShadowBoundary, "from_scene", lambda *_: [])
    without_shadows, _ = mean_gradient(MitsubaRenderer(scene, MOVES, spp=64), weight, 8)
    assert np.linalg.norm(without_shadows - expected) > 0.1 * size


def test_the_gradient_of_received_shadows_does_not_depend_on_the_resolution() -> None:
    """A box 2 pixels wide, whose front faces away from the light, has the gradient of one that is 16 pixels wide."""
    pose = mi.ScalarTransform4f().translate([1.0, 6.0, -5.0]).scale(0.5)
    lamp = {"type": "sphere", "to_world": pose, "emitter": {"type": "area", "radiance": 100.0}}
    estimates = []
    for factor in (1, 8):
        scene = shadow_scene(ball=box((0.0, 1.0, 0.0), 0.6), other=ball(0.45, 2.3, -0.9, 0.4), lamp=lamp)
        width, height = 12 * factor, 9 * factor
        scene["sensor"]["film"] |= {"width": width, "height": height}
        shadows = SHADOWS | {"sppi": 4096 // factor**2}
        renderer = MitsubaRenderer(scene, {"y": Translate("ball", (0, 1, 0))}, integrator=shadows)
        weight = np.full((height, width, 3), 1.0 / (width * height), np.float32)
        draws = [float(renderer.vjp({"y": np.float32(0.0)}, weight, seed=seed)["y"]) for seed in range(16)]
        estimates.append((np.mean(draws), np.std(draws, ddof=1) / 4.0))
    (coarse, coarse_error), (fine, fine_error) = estimates
    assert fine_error < 0.1 * abs(fine)
    assert abs(coarse - fine) < 3.0 * np.hypot(coarse_error, fine_error)


@pytest.mark.parametrize("is_box", [False, True], ids=["ball", "box"])
def test_a_convex_shape_receives_no_shadow_from_itself(is_box: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The far side of the lamp must not seem to hide a point of its rim.

    At the silhouette of a box, rounding makes rays hit a face that points away, from inside; it must not count either.
    """
    lamp = {"type": "sphere", "center": [1.5, 5.0, 1.0], "radius": 0.6, "emitter": {"type": "area", "radiance": 60.0}}
    shape = box((0.0, 1.0, 0.0), 0.6) if is_box else ball(0.0, 1.0, 0.0, 0.6)
    scene = shadow_scene(**DIRECT, ball=shape, lamp=lamp)
    weight = np.ones((HEIGHT, WIDTH, 3), np.float32)
    gradient = MitsubaRenderer(scene, MOVES, integrator=SHADOWS).vjp(START, weight)
    monkeypatch.setattr(ReceivedShadowBoundary, "from_scene", lambda *_: [])
    expected = MitsubaRenderer(scene, MOVES, integrator=SHADOWS).vjp(START, weight)
    assert all(expected.values())
    for name, value in expected.items():
        np.testing.assert_allclose(gradient[name], value, rtol=1e-5)


@pytest.mark.parametrize(("integrator", "seeds"), [(None, 12), (SHADOWS, 6)], ids=["all terms", "shadows"])
def test_no_sample_of_a_spherical_light_dominates_the_gradient(integrator: dict[str, Any] | None, seeds: int) -> None:
    """The relative derivative of the solid angle is unbounded at grazing angles."""
    lamp = {"type": "sphere", "center": [1.5, 6.0, 1.0], "radius": 0.7, "emitter": {"type": "area", "radiance": 60.0}}
    scene = shadow_scene(**DIRECT, ball=ball(0.0, 1.5, 0.0, 0.6), lamp=lamp)
    renderer = MitsubaRenderer(scene, {"y": Translate("floor", (0, 1, 0))}, integrator=integrator, spp=32)
    weight = np.ones((HEIGHT, WIDTH, 3), np.float32)
    draws = [float(renderer.vjp({"y": np.float32(0.0)}, weight, seed=seed)["y"]) for seed in range(100, 100 + seeds)]
    assert np.ptp(draws) < 0.3 * abs(np.median(draws))

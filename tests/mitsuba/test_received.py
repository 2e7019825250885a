"""Shadows that fall on what moves have a gradient, and light from surfaces seen edge-on does not outweigh it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer, Translate
from loi_mitsuba.boundary.received_shadows import ReceivedShadowBoundary
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, box, shadow_scene

MOVES: dict[str, Any] = {"x": Translate("ball", (1, 0, 0)), "z": Translate("ball", (0, 0, 1))}
HERE = {name: np.float32(0.0) for name in MOVES}
STEP = 0.03
DIRECT = {"integrator": {"type": "direct"}}
SHADOWS = {"type": "direct_projective", "guiding": "none", "sppc": 0, "sppp": 0, "sppi": 256}


def ball(x: float, y: float, z: float, radius: float) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, z], "radius": radius}


def scene_of(kind: str) -> dict[str, Any]:
    scene = shadow_scene(**DIRECT, ball=ball(0.0, 1.2, 0.0, 0.9))
    if kind == "under the sky":
        del scene["lamp"]
        return scene | {"sky": {"type": "constant", "radiance": 0.8}, "other": ball(1.7, 1.4, 0.3, 0.9)}
    return scene | {"other": ball(0.3, 3.0, 0.3, 0.5)}


def slopes_of(renderer: MitsubaRenderer, weight: Host, seeds: int) -> tuple[Host, Host]:
    """Mean gradient over seeds, and its standard error."""
    drawn = np.array([list(renderer.vjp(HERE, weight, seed=seed).values()) for seed in range(seeds)])
    return drawn.mean(axis=0), drawn.std(axis=0, ddof=1) / np.sqrt(seeds)


@pytest.mark.parametrize("kind", ["under a ball", "under the sky"])
def test_it_is_that_of_finite_differences(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(kind)
    renderer = MitsubaRenderer(scene, MOVES, spp=64)
    image = renderer.with_integrator("scene", spp=1024)
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((column - 40.0) ** 2 + (row - 18.0) ** 2) / 60.0).astype(np.float32)[..., None].repeat(3, axis=2)
    wanted = []
    for name in MOVES:
        ahead, behind = (image.render({**HERE, name: np.float32(by)}, seed=0) for by in (STEP, -STEP))
        wanted.append(float(np.sum((ahead - behind) * weight)) / (2.0 * STEP))
    found, error = slopes_of(renderer, weight, 8)
    size = float(np.linalg.norm(wanted))
    assert np.linalg.norm(error) < 0.1 * size
    assert np.linalg.norm(found - wanted) < 0.05 * size + 3.0 * np.linalg.norm(error)

    monkeypatch.setattr(ReceivedShadowBoundary, "of", lambda *_: None)
    without, _ = slopes_of(MitsubaRenderer(scene, MOVES, spp=64), weight, 8)
    assert np.linalg.norm(without - wanted) > 0.1 * size


def test_it_does_not_depend_on_how_fine_an_image_is() -> None:
    """Of a box two pixels wide, whose front is turned away from the light, no less is found than of one of sixteen."""
    place = mi.ScalarTransform4f().translate([1.0, 6.0, -5.0]).scale(0.5)
    lamp = {"type": "sphere", "to_world": place, "emitter": {"type": "area", "radiance": 100.0}}
    found = []
    for finer in (1, 8):
        scene = shadow_scene(ball=box((0.0, 1.0, 0.0), 0.6), other=ball(0.45, 2.3, -0.9, 0.4), lamp=lamp)
        width, height = 12 * finer, 9 * finer
        scene["sensor"]["film"] |= {"width": width, "height": height}
        shadows = SHADOWS | {"sppi": 4096 // finer**2}
        renderer = MitsubaRenderer(scene, {"y": Translate("ball", (0, 1, 0))}, integrator=shadows)
        weight = np.full((height, width, 3), 1.0 / (width * height), np.float32)
        drawn = [float(renderer.vjp({"y": np.float32(0.0)}, weight, seed=seed)["y"]) for seed in range(16)]
        found.append((np.mean(drawn), np.std(drawn, ddof=1) / 4.0))
    (coarse, one), (fine, other) = found
    assert other < 0.1 * abs(fine)
    assert abs(coarse - fine) < 3.0 * np.hypot(one, other)


@pytest.mark.parametrize("boxed", [False, True], ids=["ball", "box"])
def test_what_bulges_everywhere_receives_no_shadow_of_its_own(boxed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not from the lamp either, whose far side the ray to a point of its rim may seem to come from.

    Nor at the outline of a box, where rounding has rays hit the side that is turned away, from within.
    """
    lamp = {"type": "sphere", "center": [1.5, 5.0, 1.0], "radius": 0.6, "emitter": {"type": "area", "radiance": 60.0}}
    thing = box((0.0, 1.0, 0.0), 0.6) if boxed else ball(0.0, 1.0, 0.0, 0.6)
    scene = shadow_scene(**DIRECT, ball=thing, lamp=lamp)
    weight = np.ones((HEIGHT, WIDTH, 3), np.float32)
    found = MitsubaRenderer(scene, MOVES, integrator=SHADOWS).vjp(HERE, weight)
    monkeypatch.setattr(ReceivedShadowBoundary, "of", lambda *_: None)
    wanted = MitsubaRenderer(scene, MOVES, integrator=SHADOWS).vjp(HERE, weight)
    assert all(wanted.values())
    for name, value in wanted.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-5)


@pytest.mark.parametrize(("integrator", "draws"), [(None, 12), (SHADOWS, 6)], ids=["all of it", "shadows"])
def test_no_sample_of_a_round_lamp_outweighs_the_gradient(integrator: dict[str, Any] | None, draws: int) -> None:
    """Relative to itself, the solid angle of what is seen edge-on changes without bound."""
    lamp = {"type": "sphere", "center": [1.5, 6.0, 1.0], "radius": 0.7, "emitter": {"type": "area", "radiance": 60.0}}
    scene = shadow_scene(**DIRECT, ball=ball(0.0, 1.5, 0.0, 0.6), lamp=lamp)
    renderer = MitsubaRenderer(scene, {"y": Translate("floor", (0, 1, 0))}, integrator=integrator, spp=32)
    weight = np.ones((HEIGHT, WIDTH, 3), np.float32)
    drawn = [float(renderer.vjp({"y": np.float32(0.0)}, weight, seed=seed)["y"]) for seed in range(100, 100 + draws)]
    assert np.ptp(drawn) < 0.3 * abs(np.median(drawn))

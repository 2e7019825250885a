"""The gradient by clear glass that moves: of the light that it throws, of what is seen in it, and of both together."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core import LOIObjective, fit
from loi_core.errors import OptionError
from loi_mitsuba import MitsubaRenderer, PlannedRenderer, Rotate, Scale, Translate
from loi_mitsuba.attached.dielectrics import AttachedDielectrics, Samples
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.mitsuba.test_attached_emitters import RAMP, X, Y, Z, begun, differences
from tests.strategies import thorough

CLEAR = {"type": "dielectric", "int_ior": 1.5}
BALL = {"type": "sphere", "center": [-1, 1.2, 0], "radius": 0.9, "bsdf": CLEAR}
WIDE = {  # so that a path tracer hits it, and the truth has little noise
    "type": "sphere",
    "center": [1, 7, 2],
    "radius": 1.5,
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5.0, 4.0, 3.0]}},
}


def glass_scene(**changes: Any) -> dict[str, Any]:
    """A ball of clear glass over a floor, in whose caustic the camera sees the floor past the ball, and through it."""
    return shadow_scene(**{"ball": BALL, "lamp": WIDE, "integrator": {"type": "path", "max_depth": 7}, **changes})


def followed(
    scene: dict[str, Any], targets: dict[str, Any], **options: Any
) -> tuple[MitsubaRenderer, AttachedDielectrics]:
    """The scene by its own integrator, and what is followed in it."""
    renderer = MitsubaRenderer(scene, targets, integrator="scene", without_gradient=tuple(targets), **options)
    return renderer, AttachedDielectrics(renderer, 128)


def in_blocks(image: Host) -> Host:
    """Means of 8 by 8 pixels."""
    means: Host = image.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).mean(axis=(1, 3))
    return means


def test_its_samples_are_what_glass_does_to_an_image() -> None:
    """The light that it throws and takes, and what is seen in it, are the image with the ball less that without."""
    renderer, _ = followed(glass_scene(), {"x": Translate("ball", X)}, spp=256)
    here, away = {"x": np.float32(0.0)}, {"x": np.float32(100.0)}
    without = np.mean([renderer.render(away, seed=seed) for seed in range(2)], axis=0)
    images = [renderer.render(here, seed=seed) - without for seed in range(2)]
    samples = Samples(renderer.scene, renderer.sensor)
    drawn = [in_blocks(samples.image(50_000, seed)) for seed in range(4)]
    wanted, found = in_blocks(np.mean(images, axis=0)), np.mean(drawn, axis=0)
    noise = np.std(drawn, axis=0, ddof=1) / 2.0
    assert np.linalg.norm(found - wanted) < 0.1 * np.linalg.norm(wanted) + np.linalg.norm(noise)


@pytest.mark.parametrize("kind", ["one ball", pytest.param("two balls", marks=thorough)])
def test_it_is_nearly_that_of_finite_differences(kind: str) -> None:
    """Edges of what is seen in glass have no part in it: the angle is less than 15 degrees."""
    other = {"type": "sphere", "center": [1.2, 1.0, 0.3], "radius": 0.8, "bsdf": CLEAR}
    scene = glass_scene(**({} if kind == "one ball" else {"other": other}))
    targets: dict[str, Any] = {"x": Translate("ball", X), "y": Translate("ball", Y), "z": Translate("ball", Z)}
    renderer, glass = followed(scene, targets, spp=256)
    at = renderer.parameters()
    mean = np.mean([list(glass.vjp(at, RAMP, names=targets, seed=seed).values()) for seed in range(6)], axis=0)
    wanted, _ = differences(renderer, at, dict.fromkeys(targets, 0.15))
    assert mean @ wanted > np.cos(np.radians(15.0)) * np.linalg.norm(mean) * np.linalg.norm(wanted)
    assert np.linalg.norm(mean) == pytest.approx(np.linalg.norm(wanted), rel=0.25)


def test_each_parameter_has_its_own() -> None:
    targets = {"x": Translate("ball", X), "size": Scale("ball")}
    renderer, glass = followed(glass_scene(), targets, spp=4)
    at = renderer.parameters()
    both = glass.vjp(at, RAMP, names=targets)
    for name in targets:
        (alone,) = glass.vjp(at, RAMP, names=[name]).values()
        np.testing.assert_allclose(alone, both[name], rtol=1e-3)


@pytest.mark.parametrize(
    "film", [*(pytest.param(one, marks=thorough) for one in ("rgba", "luminance")), "luminance_alpha"]
)
def test_films_without_colour_or_with_alpha_have_it_too(film: str) -> None:
    """A weight of one for luminance is that of its shares of red, green and blue."""
    moved = {"x": Translate("ball", X)}
    colours, glass = followed(glass_scene(), moved, spp=4)
    shares = np.array([0.2126, 0.7152, 0.0722], np.float32)
    wanted = glass.vjp(colours.parameters(), RAMP * shares, names=moved)["x"]
    scene = glass_scene()
    scene["sensor"]["film"]["pixel_format"] = film
    other, glass = followed(scene, moved, spp=4)
    image = other.render(other.parameters())
    cotangent = np.zeros_like(image)
    if film == "rgba":
        cotangent[..., :3] = RAMP * shares
    else:
        cotangent[..., :1] = RAMP[..., :1]
    found = glass.vjp(other.parameters(), cotangent, names=moved)["x"]
    np.testing.assert_allclose(found, wanted, rtol=1e-3)


@thorough
def test_a_fit_finds_a_ball_of_glass() -> None:
    """Within half a pixel, after a way of eight: what it throws on the floor tells, and what is seen in it."""
    scene = glass_scene()
    scene["sensor"]["film"] |= {"width": 32, "height": 24}
    targets: dict[str, Any] = {"x": Translate("ball", X), "z": Translate("ball", Z)}
    planned = PlannedRenderer(scene, targets, spp=32)
    truth = {"x": np.float32(1.5), "z": np.float32(1.0)}
    target = np.mean([planned.render(truth, seed=10**6 + seed) for seed in range(4)], axis=0)
    found = fit(planned, LOIObjective(target.astype(np.float32)), steps=60)
    assert list(planned.plan.followed) == ["x", "z"]
    assert not planned.plan.blurred
    for name, value in truth.items():
        np.testing.assert_allclose(found.best_params[name], value, atol=0.11)  # a pixel is 0.22


def test_the_plan_says_so() -> None:
    (row,) = (
        line
        for line in str(PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=4).plan).splitlines()
        if line.startswith("| 'x'")
    )
    assert "it moves clear glass, and samples of what that bends move with it" in row


def test_glass_that_nobody_sees_is_blurred() -> None:
    """Nor what it throws: a lid hides both."""
    lid = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 3, 0]).scale([9, 0.1, 9])}
    plan = begun(glass_scene(lid=lid), {"x": Translate("ball", X)}, spp=4).plan
    assert list(plan.blurred) == ["x"]
    assert not plan.followed


def test_it_is_followed_where_it_cannot_be_told_from_noise() -> None:
    """The blurred gradient has ten times the noise, and a fit would have it to the end."""
    planned = PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=2)
    noise = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    plan = planned.begin(planned.parameters(), noise, optimise=["x"])
    assert list(plan.followed) == ["x"]
    assert not plan.blurred


def test_glass_that_comes_into_view_is_followed_from_then_on() -> None:
    """It begins far to the side, where it bends no light that the camera sees."""
    planned = PlannedRenderer(glass_scene(), {"x": Translate("ball", X)}, spp=4)
    planned.begin({"x": np.float32(60.0)}, RAMP, optimise=["x"])
    assert list(planned.plan.blurred) == ["x"]
    planned.render_vjp(planned.parameters())[1](RAMP)
    assert list(planned.plan.followed) == ["x"]
    assert not planned.plan.blurred


def test_what_it_does_not_know_is_blurred() -> None:
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).scale(0.7), "bsdf": CLEAR}
    turned: dict[str, Any] = {"it": Rotate("ball", Z)}
    assert list(PlannedRenderer(glass_scene(ball=box), turned, spp=4).plan.blurred) == ["it"]
    moved: dict[str, Any] = {"it": Translate("ball", X)}
    hidden = {"type": "path", "hide_emitters": True}
    assert list(PlannedRenderer(glass_scene(integrator=hidden), moved, spp=4).plan.blurred) == ["it"]
    scene = glass_scene()
    scene["sensor"] |= {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 8.0}
    assert list(PlannedRenderer(scene, moved, spp=4).plan.blurred) == ["it"]


@thorough
def test_light_from_all_around_does_not_drown_it() -> None:
    """Most of it falls far out of view, where a point of the floor is ever so large a part of the film."""
    targets = {"y": Translate("ball", Y)}
    renderer, glass = followed(glass_scene(lamp={"type": "constant"}), targets, spp=4)
    draws = [float(glass.vjp(renderer.parameters(), RAMP, names=targets, seed=seed)["y"]) for seed in range(6)]
    assert np.std(draws) < np.abs(np.mean(draws))


def test_it_can_be_turned_off() -> None:
    moved: dict[str, Any] = {"it": Translate("ball", X)}
    assert list(PlannedRenderer(glass_scene(), moved, spp=4, attached_glass=False).plan.blurred) == ["it"]
    assert list(PlannedRenderer(glass_scene(), moved, spp=4, blur={"names": ["it"]}).plan.blurred) == ["it"]
    with pytest.raises(OptionError, match="`attached_glass` must be true or false, got 1"):
        PlannedRenderer(glass_scene(), moved, attached_glass=1)  # type: ignore[arg-type]  # the wrong type is refused

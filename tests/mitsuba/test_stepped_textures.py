"""Moving checkerboards and bitmaps without interpolation have the gradient of their ramped stand-ins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Rotate, Translate
from mitsuba_boundaries.geometry.stepped_textures import has_stepped_texture, ramp_texture
from mitsuba_boundaries.loading import parsed_scene
from mitsuba_boundaries.proxy.substitutions import nodes_of_shape
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

TRANSFORM = mi.ScalarTransform4f
MOVES: dict[str, Any] = {"x": Translate("card", (1, 0, 0)), "turn": Rotate("card", (0, 1, 0))}
STEPS = {"x": 0.06, "turn": 2.0}
CHECKERBOARD: dict[str, Any] = {
    "type": "checkerboard",
    "color0": {"type": "rgb", "value": [0.9, 0.2, 0.1]},
    "color1": 0.05,
}


def texels(channels: int = 3) -> Any:
    return mi.TensorXf(np.random.default_rng(3).random((3, 5, channels), dtype=np.float32))


def nearest_bitmap(folder: Path) -> dict[str, Any]:
    """A bitmap without interpolation, of an sRGB file."""
    path = folder / "texels.png"
    mi.Bitmap(np.random.default_rng(3).integers(0, 256, (3, 5, 3), dtype=np.uint8)).write(str(path))
    return {"type": "bitmap", "filter_type": "nearest", "filename": str(path)}


TEXTURES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "board": lambda _: dict(CHECKERBOARD),
    "grey board": lambda _: {"type": "checkerboard"},
    "file": nearest_bitmap,
    "data": lambda _: {"type": "bitmap", "filter_type": "nearest", "data": texels(), "raw": True},
    "grey data": lambda _: {"type": "bitmap", "filter_type": "nearest", "data": texels(1), "raw": True},
}


def lit_scene(texture: dict[str, Any]) -> dict[str, Any]:
    """A card wider than the view under a uniform sky: without visible silhouettes and shadows."""
    pose = TRANSFORM().translate([0, 0.5, 0]).rotate([1, 0, 0], -90).scale(9)
    to_uv = TRANSFORM().rotate([0, 0, 1], 20).scale([3, 3, 1])
    bsdf = {"type": "diffuse", "reflectance": texture | {"to_uv": to_uv}}
    sky = {"type": "constant", "radiance": 1.0}
    direct = {"type": "path", "max_depth": 2}
    scene = shadow_scene(integrator=direct, lamp=sky, card={"type": "rectangle", "to_world": pose, "bsdf": bsdf})
    del scene["ball"]
    return scene


def bump() -> Host:
    """A cotangent that differs between the corners, and is 0 at the border."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 20.0) ** 2 + (rows - 18.0) ** 2) / 60.0)
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def evaluate(texture: Any, uv: Host, channels: int) -> Host:
    point = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    point.uv = mi.Point2f(uv.astype(np.float32).T)
    values = np.array(texture.eval_1(point) if channels == 1 else texture.eval(point))
    return values.reshape(-1, len(uv))


@pytest.mark.parametrize("texture_name", TEXTURES)
def test_a_ramped_texture_equals_the_stepped_one_away_from_steps(texture_name: str, tmp_path: Path) -> None:
    rotation = {"to_uv": TRANSFORM().rotate([0, 0, 1], 20).scale([3, 2, 1])}
    stepped = mi.load_dict(TEXTURES[texture_name](tmp_path) | rotation)
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": TEXTURES[texture_name](tmp_path) | rotation}}
    with parsed_scene({"type": "scene", "ball": ball}) as (config, state):
        (node,) = nodes_of_shape(state, 0, mi.ObjectType.Texture)
        assert ramp_texture(state.nodes[node].props)
        instance = mi.parser.instantiate(config, state)
    scene = instance[0] if isinstance(instance, list) else instance
    (shape,) = scene.shapes()
    assert not has_stepped_texture(shape)
    ramped = next(entry[2] for entry in mi.traverse(shape).properties.values() if isinstance(entry[2], mi.Texture))
    uv = np.random.default_rng(0).uniform(-1.0, 2.0, (4000, 2))
    channels = 1 if texture_name == "grey data" else 3
    is_equal = np.isclose(evaluate(ramped, uv, channels), evaluate(stepped, uv, channels), atol=2e-3).all(axis=0)
    assert np.mean(is_equal) == pytest.approx(0.75**2, abs=0.05)  # more than an eighth of a check from its sides


@pytest.mark.parametrize("texture_name", ["board", pytest.param("file", marks=thorough)])
def test_a_moving_texture_has_the_gradient_of_finite_differences(texture_name: str, tmp_path: Path) -> None:
    scene = lit_scene(TEXTURES[texture_name](tmp_path))
    planned = PlannedRenderer(scene, MOVES, spp=64)
    (reason,) = planned.plan.substitutions.values()
    assert "an interpolated bitmap" in reason
    start = planned.parameters()
    gradients = [planned.unabridged.vjp(start, bump(), seed=seed) for seed in range(8)]
    draws = np.array([[float(gradient[name]) for name in MOVES] for gradient in gradients])
    images, differences = planned.unabridged.with_integrator("scene", spp=256), []
    for seed in range(4):
        pairs = (
            [images.render(start | {name: start[name] + np.float32(sign * step)}, seed=seed) for sign in (1.0, -1.0)]
            for name, step in STEPS.items()
        )
        changes = np.array([np.sum((forward - backward).astype(np.float64) * bump()) for forward, backward in pairs])
        differences.append(changes / (2.0 * np.array(list(STEPS.values()))))
    expected = np.mean(differences, axis=0)
    error = np.hypot(np.std(draws, axis=0, ddof=1) / np.sqrt(8.0), np.std(differences, axis=0, ddof=1) / 2.0)
    assert np.all(np.abs(expected) > 8.0 * error)
    np.testing.assert_array_less(np.abs(np.mean(draws, axis=0) - expected), 0.1 * np.abs(expected) + 4.0 * error)


def test_the_image_keeps_the_steps_of_the_texture() -> None:
    with pytest.warns(GradientWarning, match="'card' has a texture with steps"):
        plain = MitsubaRenderer(lit_scene(CHECKERBOARD), MOVES)
    planned = PlannedRenderer(lit_scene(CHECKERBOARD), MOVES)
    np.testing.assert_array_equal(planned.render(planned.parameters()), plain.render(plain.parameters()))


NESTED: dict[str, Any] = {
    "type": "checkerboard",
    "color0": {"type": "bitmap", "data": mi.TensorXf(np.ones((2, 2, 3)))},
}


@pytest.mark.parametrize(
    ("texture", "targets", "options"),
    [
        (CHECKERBOARD, {}, {"proxy": {"textures": False}}),
        (CHECKERBOARD, {"colour": "card.bsdf.reflectance.color0.value"}, {}),
        (NESTED, {}, {}),
        (CHECKERBOARD | {"color1": 1.5}, {}, {}),
    ],
    ids=["switched off", "fitted", "nested", "bright"],
)
def test_stepped_textures_that_cannot_be_replaced_give_a_warning(
    texture: dict[str, Any], targets: dict[str, Any], options: dict[str, Any]
) -> None:
    with pytest.warns(GradientWarning, match="'card' has a texture with steps"):
        planned = PlannedRenderer(lit_scene(texture), MOVES | targets, **options)
    assert not planned.plan.substitutions

"""Checkerboards and bitmaps that are not interpolated have, where they move, the gradient of ramps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import GradientWarning, MitsubaRenderer, PlannedRenderer, Rotate, Translate
from loi_mitsuba.geometry.stepped_textures import has_stepped_texture, ramp_texture
from loi_mitsuba.proxy.substitutions import nodes_of_shape
from loi_mitsuba.scene.load import parsed_scene
from tests.helpers import Host
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene
from tests.strategies import thorough

PLACE = mi.ScalarTransform4f
MOVES: dict[str, Any] = {"x": Translate("card", (1, 0, 0)), "turn": Rotate("card", (0, 1, 0))}
STEPS = {"x": 0.06, "turn": 2.0}
BOARD: dict[str, Any] = {"type": "checkerboard", "color0": {"type": "rgb", "value": [0.9, 0.2, 0.1]}, "color1": 0.05}


def texels(channels: int = 3) -> Any:
    return mi.TensorXf(np.random.default_rng(3).random((3, 5, channels), dtype=np.float32))


def nearest(folder: Path) -> dict[str, Any]:
    """A bitmap of a file, in sRGB."""
    path = folder / "texels.png"
    mi.Bitmap(np.random.default_rng(3).integers(0, 256, (3, 5, 3), dtype=np.uint8)).write(str(path))
    return {"type": "bitmap", "filter_type": "nearest", "filename": str(path)}


KINDS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "board": lambda _: dict(BOARD),
    "grey board": lambda _: {"type": "checkerboard"},
    "file": nearest,
    "data": lambda _: {"type": "bitmap", "filter_type": "nearest", "data": texels(), "raw": True},
    "grey data": lambda _: {"type": "bitmap", "filter_type": "nearest", "data": texels(1), "raw": True},
}


def lit_scene(texture: dict[str, Any]) -> dict[str, Any]:
    """A card on the floor under an even sky, wider than the view: its outline is not seen, and there are no shadows."""
    pose = PLACE().translate([0, 0.5, 0]).rotate([1, 0, 0], -90).scale(9)
    turned = PLACE().rotate([0, 0, 1], 20).scale([3, 3, 1])
    bsdf = {"type": "diffuse", "reflectance": texture | {"to_uv": turned}}
    sky = {"type": "constant", "radiance": 1.0}
    direct = {"type": "path", "max_depth": 2}
    scene = shadow_scene(integrator=direct, lamp=sky, card={"type": "rectangle", "to_world": pose, "bsdf": bsdf})
    del scene["ball"]
    return scene


def bump() -> Host:
    """A weight that differs between the corners, and is 0 at the border."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 20.0) ** 2 + (rows - 18.0) ** 2) / 60.0)
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def seen(texture: Any, places: Host, channels: int) -> Host:
    point = dr.zeros(mi.SurfaceInteraction3f, len(places))
    point.uv = mi.Point2f(places.astype(np.float32).T)
    values = np.array(texture.eval_1(point) if channels == 1 else texture.eval(point))
    return values.reshape(-1, len(places))


@pytest.mark.parametrize("kind", KINDS)
def test_an_interpolated_texture_is_that_with_steps_but_near_them(kind: str, tmp_path: Path) -> None:
    turned = {"to_uv": PLACE().rotate([0, 0, 1], 20).scale([3, 2, 1])}
    own = mi.load_dict(KINDS[kind](tmp_path) | turned)
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": KINDS[kind](tmp_path) | turned}}
    with parsed_scene({"type": "scene", "ball": ball}, float_textures=False) as (config, state):
        (part,) = nodes_of_shape(state, 0, mi.ObjectType.Texture)
        assert ramp_texture(state.nodes[part].props)
        made = mi.parser.instantiate(config, state)
    scene = made[0] if isinstance(made, list) else made
    (shape,) = scene.shapes()
    assert not has_stepped_texture(shape)
    near = next(one[2] for one in mi.traverse(shape).properties.values() if isinstance(one[2], mi.Texture))
    places = np.random.default_rng(0).uniform(-1.0, 2.0, (4000, 2))
    channels = 1 if kind == "grey data" else 3
    equal = np.isclose(seen(near, places, channels), seen(own, places, channels), atol=2e-3).all(axis=0)
    assert np.mean(equal) == pytest.approx(0.75**2, abs=0.05)  # at more than an eighth of a check from its sides


@pytest.mark.parametrize("kind", ["board", pytest.param("file", marks=thorough)])
def test_a_texture_that_moves_has_the_gradient_of_finite_differences(kind: str, tmp_path: Path) -> None:
    scene = lit_scene(KINDS[kind](tmp_path))
    planned = PlannedRenderer(scene, MOVES, spp=64)
    (reason,) = planned.plan.exchanged.values()
    assert "an interpolated bitmap" in reason
    here = planned.parameters()
    drawn = [planned.unabridged.vjp(here, bump(), seed=seed) for seed in range(8)]
    found = np.array([[float(one[name]) for name in MOVES] for one in drawn])
    images, slopes = planned.unabridged.with_integrator("scene", spp=256), []
    for seed in range(4):
        sides = (
            [images.render(here | {n: here[n] + np.float32(h)}, seed=seed) for h in (s, -s)] for n, s in STEPS.items()
        )
        changes = np.array([np.sum((ahead - behind).astype(np.float64) * bump()) for ahead, behind in sides])
        slopes.append(changes / (2.0 * np.array(list(STEPS.values()))))
    wanted = np.mean(slopes, axis=0)
    error = np.hypot(np.std(found, axis=0, ddof=1) / np.sqrt(8.0), np.std(slopes, axis=0, ddof=1) / 2.0)
    assert np.all(np.abs(wanted) > 8.0 * error)
    np.testing.assert_array_less(np.abs(np.mean(found, axis=0) - wanted), 0.1 * np.abs(wanted) + 4.0 * error)


def test_the_image_is_that_of_the_texture_with_its_steps() -> None:
    with pytest.warns(GradientWarning, match="'card' has a texture with steps"):
        alone = MitsubaRenderer(lit_scene(BOARD), MOVES)
    planned = PlannedRenderer(lit_scene(BOARD), MOVES)
    np.testing.assert_array_equal(planned.render(planned.parameters()), alone.render(alone.parameters()))


TEXTURED: dict[str, Any] = {
    "type": "checkerboard",
    "color0": {"type": "bitmap", "data": mi.TensorXf(np.ones((2, 2, 3)))},
}


@pytest.mark.parametrize(
    ("texture", "more", "options"),
    [
        (BOARD, {}, {"proxy": {"textures": False}}),
        (BOARD, {"colour": "card.bsdf.reflectance.color0.value"}, {}),
        (TEXTURED, {}, {}),
        (BOARD | {"color1": 1.5}, {}, {}),
    ],
    ids=["switched off", "fitted", "of textures", "bright"],
)
def test_where_nothing_can_be_exchanged_a_warning_says_so(
    texture: dict[str, Any], more: dict[str, Any], options: dict[str, Any]
) -> None:
    with pytest.warns(GradientWarning, match="'card' has a texture with steps"):
        planned = PlannedRenderer(lit_scene(texture), MOVES | more, **options)
    assert not planned.plan.exchanged

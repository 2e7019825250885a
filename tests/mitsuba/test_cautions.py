"""Where Mitsuba's gradients are missing or doubled, the renderer says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_mitsuba import GradientWarning, MitsubaRenderer, Translate
from tests.mitsuba.scenes import PARAMETERS, box, random_cotangent, shadow_scene


@pytest.mark.parametrize(
    ("light", "kind"),
    [
        ({"type": "point", "position": [0, 12, 0]}, "PointLight"),
        ({"type": "directional", "direction": [0, -1, 0]}, "DirectionalEmitter"),
    ],
)
def test_shadows_without_a_gradient_are_warned_of(light: dict[str, Any], kind: str) -> None:
    with pytest.warns(GradientWarning, match=f"a shape moves under a {kind}, .*use a small sphere"):
        renderer = MitsubaRenderer(shadow_scene(lamp=light), {"place": Translate("ball")})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert not np.any(gradient["place"])  # the ball is out of view, so its shadow is all there is: the warning is true
    MitsubaRenderer(shadow_scene(lamp=light), {"floor": PARAMETERS["floor"]})  # nothing moves: no warning


def test_integrators_without_outlines_are_warned_of() -> None:
    with pytest.warns(GradientWarning, match="has no gradient of moving silhouettes and shadows; use direct_proj"):
        renderer = MitsubaRenderer(shadow_scene(), {"place": Translate("ball")}, integrator={"type": "direct"})
    gradient = renderer.render_vjp(renderer.parameters())[1](random_cotangent())
    assert not np.any(gradient["place"])  # the ball is out of view, so its shadow is all there is: the warning is true


def test_shapes_in_groups_are_warned_of() -> None:
    group = {"type": "shapegroup", "ball": {"type": "sphere"}}
    scene = shadow_scene(group=group, one={"type": "instance", "of": {"type": "ref", "id": "group"}})
    with pytest.warns(GradientWarning, match="shape 'ball' moves in a shapegroup, .*has no gradient; put the shape"):
        MitsubaRenderer(scene, {"place": Translate("group.ball")})


def test_colours_of_vertices_do_not_move_a_mesh() -> None:
    coloured = box((1.0, 0.6, 0.0), 0.4)
    coloured.add_attribute("vertex_color", 3, [0.5] * 24)
    scene = shadow_scene(box=coloured, sensor={"type": "orthographic"}, lamp={"type": "point", "position": [0, 12, 0]})
    renderer = MitsubaRenderer(scene, {"colours": "box.vertex_color"})  # neither refused nor warned of
    assert renderer.parameters()["colours"].shape == (24,)


def test_meshes_that_count_twice_are_warned_of() -> None:
    with pytest.warns(GradientWarning, match="mesh 'cube' stores the vertices of an edge more than once"):
        MitsubaRenderer(shadow_scene(cube={"type": "cube"}), {"place": Translate("cube")})


def test_many_meshes_are_warned_of_once(recwarn: pytest.WarningsRecorder) -> None:
    """However many parameters move each."""
    cubes = {f"cube {k}": {"type": "cube"} for k in range(7)}
    moved = {f"{name} {axis}": Translate(name, axis) for name in cubes for axis in ((1, 0, 0), (0, 1, 0))}
    MitsubaRenderer(shadow_scene(**cubes), moved)
    (message,) = [str(one.message) for one in recwarn if one.category is GradientWarning]
    assert message.startswith(
        "meshes 'cube 0', 'cube 1', 'cube 2', 'cube 3' and 3 others store the vertices of an edge"
    )

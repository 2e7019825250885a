"""A loop with ``mi.render`` gets all boundary terms from the integrators of ``mitsuba_boundaries``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_mitsuba import MitsubaRenderer
from mitsuba_boundaries import INTEGRATORS
from tests.helpers import Host
from tests.mitsuba.moving_scenes import SCENES
from tests.mitsuba.scenes import box, random_cotangent, shadow_scene
from tests.strategies import thorough

DIRECT = {"type": "direct_boundaries", "guiding": "none"}
FAST = ("two boxes that intersect", "shadow of a ball out of view under a point light")
POINT = {"type": "point", "position": [1.0, 6.0, 2.0], "intensity": 60.0}


def box_and_ball() -> dict[str, Any]:
    """A box and a ball that touch nothing, over a floor."""
    ball = {"type": "sphere", "center": [-1.5, 1.0, 0.5], "radius": 0.6}
    return shadow_scene(ball=ball, box=box((1.0, 1.2, 0.0), 0.5))


@pytest.fixture
def scene() -> Any:
    return mi.load_dict(box_and_ball())


@pytest.mark.parametrize("name", [name if name in FAST else pytest.param(name, marks=thorough) for name in SCENES])
def test_the_gradient_in_a_loop_agrees_with_central_differences(name: str, tmp_path: Path) -> None:
    (agreement,) = SCENES[name].agreement(tmp_path, [DIRECT], spp=128, seeds=4)
    assert agreement.cosine > 0.99
    assert agreement.norm == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("name", "extended"), INTEGRATORS.items())
def test_the_image_is_that_of_the_extended_integrator(name: str, extended: str, scene: Any) -> None:
    image, expected = (mi.render(scene, integrator=mi.load_dict({"type": kind}), spp=4) for kind in (name, extended))
    np.testing.assert_array_equal(np.array(image), np.array(expected))


def test_the_integrators_are_registered_with_each_variant() -> None:
    for variant in ("scalar_rgb", "llvm_ad_mono", "llvm_ad_rgb"):
        mi.set_variant(variant)
        if not variant.startswith("scalar"):  # which have no gradients
            for name, extended in INTEGRATORS.items():
                integrator, base = (mi.load_dict({"type": kind}) for kind in (name, extended))
                # By name, as Mitsuba may have imported its module a second time, under another name.
                assert type(base).__name__ in [ancestor.__name__ for ancestor in type(integrator).__mro__]


def test_grid_guiding_is_refused_because_mitsuba_has_hardly_any_shadows_with_it() -> None:
    with pytest.raises(RuntimeError, match=r'`guiding` is "grid", .*use "none" or "octree"'):
        mi.load_dict({"type": "direct_boundaries", "guiding": "grid"})
    mi.load_dict({"type": "direct_boundaries", "guiding": "grid", "sppi": 0})


def test_a_renderer_has_the_gradient_of_the_integrator(scene: Any) -> None:
    names = {"box": "box.vertex_positions", "floor": "floor.bsdf.reflectance.value"}
    renderer = MitsubaRenderer(scene, names, spp=16)
    expected = renderer.vjp(renderer.parameters(), random_cotangent(), seed=0)
    params = mi.traverse(scene)
    for key in names.values():
        dr.enable_grad(params[key])
    params.update()
    seed = int(np.random.SeedSequence(0).generate_state(2)[1])  # as the renderer's, of the gradient
    mi.load_dict(DIRECT).render_backward(scene, params, mi.TensorXf(random_cotangent()), 0, seed, 16)
    for name, key in names.items():
        np.testing.assert_allclose(_flat(dr.grad(params[key])), expected[name].ravel(), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "light"),
    [
        ("direct_boundaries", "sphere"),
        pytest.param("direct_boundaries", "point", marks=thorough),
        pytest.param("prb_boundaries", "sphere", marks=thorough),
    ],
)
def test_forward_and_backward_mode_are_adjoint(name: str, light: str) -> None:
    scene = mi.load_dict(box_and_ball() | ({"lamp": POINT} if light == "point" else {}))
    integrator = mi.load_dict({"type": name, "guiding": "none", "max_depth": 3})
    params = mi.traverse(scene)
    start, cotangent = params["box.vertex_positions"], random_cotangent()

    def move(x: Any) -> Any:
        params["box.vertex_positions"] = dr.ravel(dr.unravel(mi.Point3f, dr.detach(start)) + mi.Vector3f(x, 0.0, 0.0))
        params.update()

    x = mi.Float(0.0)
    dr.enable_grad(x)
    move(x)
    dr.backward(dr.sum(mi.render(scene, params, integrator=integrator, spp=16) * mi.TensorXf(cotangent), axis=None))
    backward = float(dr.grad(x)[0])

    x = mi.Float(0.0)
    dr.enable_grad(x)
    move(x)
    dr.forward(x, dr.ADFlag.ClearEdges)
    image = mi.render(scene, params, integrator=integrator, spp=16)
    derivative = np.array(dr.forward_to(image), dtype=np.float64)
    assert backward == pytest.approx(float(np.sum(derivative * cotangent)), rel=1e-3)
    assert abs(backward) > 1.0


def _flat(value: Any) -> Host:
    return np.array(value, dtype=np.float32).reshape(-1)

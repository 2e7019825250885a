"""Gradients replace parts of an integrator in a view of it, and change neither the integrator nor Mitsuba."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mitsuba_boundaries.area_jacobian import FUNCTION, corrected_sample
from mitsuba_boundaries.gradient import ImageGradient
from tests.mitsuba.scenes import HEIGHT, WIDTH, shadow_scene

RAMP = np.linspace(-1.0, 1.0, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, WIDTH, 3), np.float32)


def moving_scene() -> tuple[Any, Any]:
    """A scene whose ball moves along x, and the position with its gradient enabled."""
    scene = mi.load_dict(shadow_scene())
    params = mi.traverse(scene)
    x = mi.Float(0.0)
    dr.enable_grad(x)
    params["ball.to_world"] = mi.Transform4f().translate(mi.Vector3f(x, 0.0, 0.0)) @ params["ball.to_world"]
    params.update()
    return scene, x


def gradient_of(scene: Any, integrator: Any) -> None:
    ImageGradient(scene, scene.sensors()[0], scene.silhouette_shapes()).vjp(integrator, RAMP, seed=1, spp=4)


@pytest.mark.parametrize("integrator_type", ["direct_projective", "prb_projective"])
def test_a_gradient_changes_neither_the_integrator_nor_its_module_even_if_it_fails(
    integrator_type: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    integrator = mi.load_dict({"type": integrator_type, "guiding": "none"})
    module: Any = sys.modules[type(integrator).__module__]
    jacobian, attributes = getattr(module, FUNCTION), dict(vars(integrator))
    seen = []
    prepare = type(integrator).prepare

    def watched(self: Any, *arguments: Any) -> Any:
        seen.append(getattr(module, FUNCTION) is jacobian and vars(integrator) == attributes)
        if len(seen) == 3:  # one preparation for each term
            message = "the third term fails"
            raise RuntimeError(message)
        return prepare(self, *arguments)

    monkeypatch.setattr(type(integrator), "prepare", watched)
    scene, _ = moving_scene()
    with pytest.raises(RuntimeError, match="the third term fails"):
        gradient_of(scene, integrator)
    assert seen == [True, True, True]
    assert getattr(module, FUNCTION) is jacobian
    assert vars(integrator) == attributes


def test_a_subclass_may_extend_any_method_of_mitsuba_s_integrators() -> None:
    base: Any = mi.ad.integrators.direct_projective.DirectProjectiveIntegrator
    called = set()

    class Watched(base):  # type: ignore[misc]
        def prepare(self, *arguments: Any) -> Any:
            called.add("prepare")
            return super().prepare(*arguments)

        def sample(self, *arguments: Any, **options: Any) -> Any:
            called.add("sample")
            return super().sample(*arguments, **options)

        def sample_importance(self, *arguments: Any) -> Any:
            called.add("sample_importance")
            return super().sample_importance(*arguments)

    properties = mi.Properties()
    properties["guiding"] = "none"
    slopes = []
    for cls in (Watched, base):
        scene, x = moving_scene()
        gradient_of(scene, cls(properties))
        slopes.append(float(dr.grad(x)[0]))
    assert called == {"prepare", "sample", "sample_importance"}
    assert slopes[0] == pytest.approx(slopes[1], rel=0.1)  # its `sample` has Mitsuba's own area Jacobian


def test_an_integrator_without_an_area_jacobian_keeps_its_own_sample() -> None:
    integrator = mi.load_dict({"type": "prbvolpath"})
    assert corrected_sample(integrator, moving_scene()[0]) == integrator.sample


@pytest.mark.parametrize(
    "description",
    [
        {"type": "direct_projective", "guiding": "none"},
        {"type": "prb_projective", "guiding": "none"},
        {"type": "prb"},
    ],
)
def test_a_gradient_is_the_same_after_mitsuba_s_classes_are_loaded_again(
    description: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an import of ``mitsuba.ad.integrators`` does: an integrator then has classes of either copy."""
    gradients = []
    common = mi.ad.integrators.common
    for name, value in dict(vars(common)).items():
        monkeypatch.setattr(common, name, value)  # restored after the test
    for reload in (False, True):
        scene, x = moving_scene()
        integrator = mi.load_dict(description)
        if reload:
            importlib.reload(common)
        gradient_of(scene, integrator)
        gradients.append(float(dr.grad(x)[0]))
    assert gradients[0] != 0.0
    assert gradients[1] == gradients[0]

"""A renderer that is not ours keeps the contract through its adapter, and can be fitted with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given

from examples.adapters.deodr_mesh import DeodrMesh, sphere
from loi_core import Free, LOIObjective, Objective, PixelL2, Renderer, ScaleSpace, fit
from loi_core.errors import ImageError, LoiError, ParameterError, RendererError
from loi_core.testing import check_renderer
from tests.helpers import Host, directional_difference
from tests.strategies import SEEDS

VERTICES, FACES, COLOURS = sphere()


def mesh(seed: int = 0, **options: Any) -> DeodrMesh:
    """A coloured sphere in a random pose, wholly or partly in the frame or next to it."""
    rng = np.random.default_rng(seed)
    pose: dict[str, Any] = {
        "translation": (*rng.uniform(-2, 2, 2), rng.uniform(4, 8)),
        "rotation": rng.standard_normal(3),
    }
    pose["rotation"] *= float(seed % 5 > 0)  # no rotation at all is where formulas divide by the angle
    look: dict[str, Any] = {"colours": COLOURS, "background": (0.1, 0.2, 0.3)}
    return DeodrMesh(48, 56, VERTICES, FACES, **(look | pose | options))


def noise(seed: int, shape: tuple[int, ...]) -> Host:
    return np.random.default_rng(seed).standard_normal(shape)


def gradient_error(renderer: DeodrMesh, params: dict[str, Any], name: str, seed: int) -> float:
    """Of the pullback's slope along a random direction, against differences, by the size of what goes into it."""
    image, pullback = renderer.render_vjp(params)
    cotangent, direction = noise(seed + 1, image.shape), noise(seed + 2, params[name].shape)

    def along(value: Host) -> float:
        return float(np.sum(cotangent * renderer.render({**params, name: value})))

    slope = float(np.sum(pullback(cotangent)[name] * direction))
    measured = [directional_difference(along, params[name], direction, step) for step in (1e-6, 1e-7)]
    return min(abs(one - slope) for one in measured) / float(np.linalg.norm(cotangent) * np.linalg.norm(direction))


@given(SEEDS)
def test_pullback_equals_finite_differences(seed: int) -> None:
    renderer = mesh(seed)
    params = renderer.parameters()
    assert list(renderer.render_vjp(params)[1](np.zeros((48, 56, 3)))) == list(params)
    for name in params:
        # The image has a kink wherever an outline crosses the centre of a pixel. About one pose in two hundred has one
        # within the step, which says nothing about the gradient; poses beside it then hardly ever all do.
        beside = ({**params, "translation": params["translation"] + shift} for shift in (0.0, 1e-3, 2e-3))
        assert any(gradient_error(renderer, pose, name, seed) <= 5e-7 for pose in beside)


@given(SEEDS)
def test_pullback_is_linear_and_unmoved_by_what_is_rendered_since(seed: int) -> None:
    renderer = mesh(seed)
    params = renderer.parameters()
    image, pullback = renderer.render_vjp(params)
    one, other = noise(seed, (2, *image.shape))
    first, second = pullback(one), pullback(other)
    moved = {**params, "translation": params["translation"] + 0.3}
    renderer.render_vjp(moved)[1](one)
    image *= 0.0  # the caller's to change
    both, again = pullback(2.0 * one - 3.0 * other), pullback(one)
    for name in both:
        np.testing.assert_array_equal(again[name], first[name])
        scale = np.abs(first[name]).max() + np.abs(second[name]).max()
        np.testing.assert_allclose(both[name], 2.0 * first[name] - 3.0 * second[name], atol=1e-12 * (1.0 + scale))


@given(SEEDS)
def test_nothing_is_changed_and_the_image_is_determined(seed: int) -> None:
    renderer = mesh(seed)
    assert isinstance(renderer, Renderer)
    params = renderer.parameters()
    kept = {name: value.copy() for name, value in params.items()}
    image, pullback = renderer.render_vjp(params)
    cotangent = noise(seed, image.shape)
    cotangent.setflags(write=False)
    gradient = pullback(cotangent)
    np.testing.assert_array_equal(renderer.render(params, seed=7), image)
    np.testing.assert_array_equal(mesh(seed).render(params), image)
    assert image.shape == (48, 56, 3)
    for name, value in params.items():
        np.testing.assert_array_equal(value, kept[name])
        assert gradient[name].shape == value.shape
        assert value.dtype == gradient[name].dtype == image.dtype == np.float64


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (1.2, 0.0), (0.0, 1.2), (-0.7, -0.9)])
def test_the_mesh_is_drawn_where_the_camera_sees_it(x: float, y: float) -> None:
    scene = mesh(colours=np.ones_like(COLOURS), background=(0.0, 0.0, 0.0), translation=(x, y, 9.0))
    weights = scene.render(scene.parameters())[..., 0]
    rows, columns = np.mgrid[:48, :56] + 0.5
    focal = 24.0 / np.tan(np.radians(22.5))
    centre = np.array([np.sum(columns * weights), np.sum(rows * weights)]) / weights.sum()
    # A sphere off the axis is seen as an ellipse whose centre lies a little further out.
    np.testing.assert_allclose(centre, [28.0 + focal * x / 9.0, 24.0 + focal * y / 9.0], atol=0.15)
    # Drawn to its outline; DEODR puts its edge's ramp outside of that, half of it counts.
    np.testing.assert_allclose(np.sqrt(weights.sum() / np.pi), focal / np.sqrt(80.0) + 0.5, atol=0.25)


def test_a_quarter_turn_about_x_takes_y_to_z() -> None:
    scene = mesh(translation=(0.0, 0.0, 6.0), rotation=(0.5 * np.pi, 0.0, 0.0))
    facing = scene.render(scene.parameters())[24, 28]  # of the turned sphere, this is its own (0, -1, 0)
    np.testing.assert_allclose(facing, [0.5, 0.0, 0.5], atol=0.05)


def test_local_histograms_find_a_mesh_without_overlap_and_pixels_do_not() -> None:
    truth, start = np.array([1.5, 1.2, 8.0]), np.array([-1.5, -1.3, 9.0])
    scene = DeodrMesh(64, 64, VERTICES, FACES, COLOURS, translation=truth)
    reference = scene.render(scene.parameters())
    beginning = scene.render({**scene.parameters(), "translation": start})
    assert not np.any((reference > 0.0) & (beginning > 0.0))

    def error(objective: Objective) -> float:
        free = {"translation": Free(start, [-4.0, -4.0, 4.0], [4.0, 4.0, 14.0])}
        found = fit(scene, objective, steps=150, learning_rate=0.15, optimise=free)
        return float(np.linalg.norm(found.best_params["translation"] - truth))

    assert error(LOIObjective(reference, ScaleSpace.for_image(64, 64))) < 0.05
    assert error(PixelL2(reference)) > 1.0


@pytest.mark.parametrize(
    ("kind", "make", "says"),
    [
        (RendererError, lambda: DeodrMesh(9, 9, VERTICES, FACES[:, ::-1], COLOURS), "DEODR refused: The volume within"),
        (ParameterError, lambda: DeodrMesh(9, 9, VERTICES, FACES + 1, COLOURS), "`faces` must name vertices 0 to 257"),
        (ParameterError, lambda: DeodrMesh(9, 9, VERTICES, FACES * 1.0, COLOURS), "`faces` must be whole numbers"),
        (ParameterError, lambda: DeodrMesh(9, 9, VERTICES, FACES[[0, 0]], COLOURS), "`faces` must be wound alike"),
        (
            ParameterError,
            lambda: DeodrMesh(9, 9, VERTICES, FACES, COLOURS[1:]),
            r"`colours` must have shape \(258, 3\)",
        ),
        (ParameterError, lambda: mesh(field_of_view=180.0), "`field_of_view` must be between 0 and 180 degrees"),
        (ParameterError, lambda: placed(0.0, 0.0, 0.5), r"keep all vertices at z >= 0.01, got one at z = -0.5"),
        (ParameterError, lambda: placed(1e6, 0.0, 5.0), r"keep all vertices within 32000 pixels, got 1.44"),
        (ParameterError, lambda: mesh().render({"rotation": np.zeros(3)}), "`params` must have exactly the names"),
        (ImageError, lambda: cotangent_of_shape(48, 56, 1), r"`cotangent` must have the image's shape \(48, 56, 3\)"),
    ],
)
def test_errors_of_the_deodr_adapter_name_wrong_values(kind: type[LoiError], make: Any, says: str) -> None:
    with pytest.raises(kind, match=says):
        make()


def placed(*translation: float) -> Host:
    scene = mesh(rotation=np.zeros(3))
    return scene.render({**scene.parameters(), "translation": np.array(translation)})


def cotangent_of_shape(*shape: int) -> dict[str, Host]:
    scene = mesh()
    return scene.render_vjp(scene.parameters())[1](np.ones(shape))


def test_the_deodr_adapter_passes_the_conformance_kit() -> None:
    check_renderer(mesh(3))

"""The NumPy renderers keep the contract: exact pullbacks, unchanged arguments, checked values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core import Renderer
from loi_core.errors import ParameterError
from loi_core.renderers import Disks, Warp
from tests.helpers import Host, directional_difference
from tests.strategies import SEEDS


def disks(seed: int, **options: Any) -> Disks:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-2.0, 26.0, (5, 2))
    return Disks(20, 24, positions, rng.uniform(0.3, 7.0, 5), rng.uniform(0, 1, (5, 3)), (0.2, 0.3, 0.4), **options)


def warp(seed: int, **options: Any) -> Warp:
    rng = np.random.default_rng(seed)
    return Warp(
        rng.uniform(0, 1, (7, 9, 4)),
        rng.uniform(0, 1, (20, 24, 3)),
        rng.uniform(-8, 8, 2),
        rng.uniform(-180, 180),
        rng.uniform(0.5, 2.0),
        rng.uniform(-1, 1),
        **options,
    )


MAKERS = st.sampled_from([disks, warp])


@given(MAKERS, SEEDS)
def test_the_pullback_of_a_numpy_renderer_equals_finite_differences(maker: Any, seed: int) -> None:
    renderer = maker(seed)
    params = renderer.parameters()
    image, pullback = renderer.render_vjp(params)
    cotangent = np.random.default_rng(seed + 1).standard_normal(image.shape)
    gradient = pullback(cotangent)
    assert list(gradient) == list(params)
    for name, start in params.items():
        direction = np.random.default_rng(seed + 2).standard_normal(start.shape)

        def product(value: Host, name: str = name) -> float:
            return float(np.sum(cotangent * renderer.render({**params, name: value})))

        slope = float(np.sum(gradient[name] * direction))
        # A disk's area in a pixel is not smooth where its edge touches a pixel border, and bilinear sampling is not
        # smooth at the centre of a texel. A small step rarely crosses such a point, and two steps hardly ever both do.
        differences = [directional_difference(product, start, direction, step) for step in (1e-6, 1e-8)]
        scale = float(np.linalg.norm(cotangent))
        assert min(abs(difference - slope) for difference in differences) < 1e-5 * scale * max(
            1.0, float(np.linalg.norm(direction))
        )


@given(MAKERS, SEEDS)
def test_the_pullback_of_a_numpy_renderer_is_linear_and_reusable(maker: Any, seed: int) -> None:
    image, pullback = maker(seed).render_vjp(maker(seed).parameters())
    left, right = np.random.default_rng(seed).standard_normal((2, *image.shape))
    first, second, combined = pullback(left), pullback(right), pullback(2.0 * left - 3.0 * right)
    for name in combined:
        scale = np.abs(first[name]).max() + np.abs(second[name]).max()
        np.testing.assert_allclose(combined[name], 2.0 * first[name] - 3.0 * second[name], atol=1e-12 * (1.0 + scale))


@given(MAKERS, SEEDS, st.sampled_from(["float32", "float64"]))
def test_arguments_are_not_changed_and_dtypes_agree(maker: Any, seed: int, dtype: str) -> None:
    renderer = maker(seed, dtype=dtype)
    assert isinstance(renderer, Renderer)
    params = renderer.parameters()
    copies = {name: value.copy() for name, value in params.items()}
    image, pullback = renderer.render_vjp(params)
    reseeded = renderer.render(params, seed=5)
    gradient = pullback(image)
    np.testing.assert_array_equal(image, reseeded)
    for name, value in params.items():
        np.testing.assert_array_equal(value, copies[name])
        assert gradient[name].shape == value.shape
        assert value.dtype == gradient[name].dtype == image.dtype == np.dtype(dtype)
    assert image.shape == (20, 24, 3)


@given(st.floats(8.0, 24.0), st.floats(8.0, 24.0), st.floats(0.05, 7.9))
def test_the_coverage_of_a_disk_sums_to_its_area_at_every_position(x: float, y: float, radius: float) -> None:
    scene = Disks(32, 32, [[x, y]], radius, [[1.0, 0.5, 0.25]])
    image, pullback = scene.render_vjp(scene.parameters())
    np.testing.assert_allclose(image.sum(axis=(0, 1)), np.pi * radius**2 * np.array([1, 0.5, 0.25]), rtol=1e-9)
    gradient = pullback(np.ones_like(image))
    # The total is constant under motion, and its derivative with respect to the radius is the circumference.
    np.testing.assert_allclose(gradient["positions"], 0.0, atol=1e-9)
    np.testing.assert_allclose(gradient["radii"], 1.75 * 2.0 * np.pi * radius, rtol=1e-9)


def test_later_disks_cover_earlier_ones() -> None:
    scene = Disks(9, 9, [[4.5, 4.5], [4.5, 4.5]], [4.0, 2.0], [[1, 0, 0], [0, 1, 0]])
    image = scene.render(scene.parameters())
    assert image[4, 4].tolist() == pytest.approx([0, 1, 0], abs=1e-12)
    assert image[4, 1].tolist() == pytest.approx([1, 0, 0], abs=1e-12)


def test_disks_outside_the_frame_have_no_coverage_and_no_gradient() -> None:
    scene = Disks(9, 9, [[-50.0, 4.0], [4.0, 1e9]], 3.0, [[1, 0, 0], [0, 1, 0]], (0.1, 0.2, 0.3))
    image, pullback = scene.render_vjp(scene.parameters())
    np.testing.assert_array_equal(image, np.broadcast_to([0.1, 0.2, 0.3], (9, 9, 3)))
    assert not any(np.any(value) for value in pullback(np.ones_like(image)).values())


@given(SEEDS, st.integers(1, 9))
def test_confined_disks_lie_in_the_frame_without_overlap(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-50, 114, (count, 2)) if seed % 3 else np.full((count, 2), 32.0)
    scene = Disks(64, 64, positions, 4.0, np.ones((count, 3)), confine=True)
    moved = scene.project(scene.parameters())["positions"]
    assert np.all((moved >= 4.0) & (moved <= 60.0))
    for _ in range(30):  # a fit projects after every step; coincident disks take a few projections
        moved = scene.project({**scene.parameters(), "positions": moved})["positions"]
    distances = np.linalg.norm(moved[:, None] - moved[None, :], axis=-1) + 1e9 * np.eye(count)
    assert distances.min() > 8.0 - 0.1


def test_a_warp_with_the_identity_pastes_its_picture_in_the_centre() -> None:
    rng = np.random.default_rng(3)
    picture, background = rng.uniform(0, 1, (4, 6, 3)), rng.uniform(0, 1, (10, 12, 3))
    scene = Warp(picture, background)
    expected = background.copy()
    expected[3:7, 3:9] = picture
    np.testing.assert_allclose(scene.render(scene.parameters()), expected, atol=1e-12)
    moved = scene.render({**scene.parameters(), "translation": np.array([3.0, -3.0])})
    np.testing.assert_allclose(moved[0:4, 6:12], picture, atol=1e-12)
    rotated = scene.render({**scene.parameters(), "rotation": np.array(180.0)})
    np.testing.assert_allclose(rotated[3:7, 3:9], picture[::-1, ::-1], atol=1e-12)
    brighter = scene.render({**scene.parameters(), "exposure": np.array(1.0)})
    np.testing.assert_allclose(brighter, 2.0 * expected, atol=1e-12)


def test_a_positive_rotation_is_clockwise_on_the_screen() -> None:
    picture = np.zeros((5, 5, 3))
    picture[0, 2] = 1.0  # the top
    scene = Warp(picture, np.zeros((5, 5, 3)), rotation=90.0)
    image = scene.render(scene.parameters())
    assert image[2, 4].tolist() == pytest.approx([1, 1, 1])  # on the right


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Disks(0, 5, [[1, 1]], 1, [[1, 1, 1]]), "`height` must be a whole number of pixels"),
        (lambda: Disks(5, 5, [[1, 1, 1]], 1, [[1, 1, 1]]), r"`positions` must have shape \(n, 2\), got \(1, 3\)"),
        (lambda: Disks(5, 5, [[1, 1]], [1, 2], [[1, 1, 1]]), r"`radii` must have shape \(1,\), got \(2,\)"),
        (lambda: Disks(5, 5, [[1, np.nan]], 1, [[1, 1, 1]]), "`positions` must be finite, got 1 values that are not"),
        (lambda: Disks(5, 5, [[1, 1]], 1, "red"), "`colours` must be numbers of shape"),  # type: ignore[arg-type]
        (lambda: Disks(5, 5, [[1, 1]], 1, [[1, 1, 1]], dtype="int"), "`dtype` must be 'float64' or 'float32'"),
        (lambda: Warp(np.zeros((2, 2)), np.zeros((5, 5, 3))), r"`picture` must have shape \(n, n, n\)"),
        (lambda: Warp(np.zeros((2, 2, 2)), np.zeros((5, 5, 3))), r"`picture` must be \(H, W, 3 or 4\)"),
        (lambda: warp(1).render({**warp(1).parameters(), "scale": np.array(0.0)}), "`scale` must be more than 0"),
        (lambda: warp(1).render({"scale": np.array(1.0)}), "`params` must have exactly the names"),
        (lambda: disks(1).render({**disks(1).parameters(), "radii": np.ones(3)}), r"`radii` must have shape \(5,\)"),
    ],
)
def test_wrong_values_of_a_numpy_renderer_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()

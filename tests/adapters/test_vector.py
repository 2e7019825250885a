"""Tests of vector graphics on torch: exact areas, gradients equal to central differences, and degenerate shapes."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from loi_core import available_renderers
from loi_core.errors import OptionError, ParameterError
from loi_core.renderers import Disks
from loi_core.testing import RendererSubject, parametrize_with_checks
from loi_torch.vector import Circle, Ellipse, Outline, Paint, Path, Rectangle, Shape, Vector, polygon
from tests.helpers import Host
from tests.strategies import SEEDS

RED, TRANSLUCENT_BLUE = (0.9, 0.2, 0.1, 1.0), (0.1, 0.3, 0.8, 0.6)
WHITE, BLACK = Paint(fill=(1.0, 1.0, 1.0, 1.0)), (0.0, 0.0, 0.0)


def scene(seed: int = 0, **options: Any) -> Vector:
    """Return a renderer of every kind of shape and fill, with overlaps and a shape partly outside the frame."""
    rng = np.random.default_rng(seed)
    circle_centre, rectangle_centre, triangle_centre = rng.uniform(4.0, 28.0, (3, 2))
    curve = np.array([[2, 20], [6, 8], [12, 30], [17, 20], [21, 12], [27, 24]]) + rng.uniform(-1.5, 1.5, (6, 2))
    leaf = np.array([[4, 15], [6, 6], [14, 2], [20, 5], [22, 14]]) + rng.uniform(-1.0, 1.0, (5, 2))
    shapes: list[Shape] = [
        Circle(circle_centre, rng.uniform(3, 6), Paint(RED, TRANSLUCENT_BLUE, 2.3)),
        Ellipse([31.0, 9.0], rng.uniform(2, 7, 2), Paint(TRANSLUCENT_BLUE), rng.uniform(-180, 180)),
        Rectangle(
            rectangle_centre,
            rng.uniform(6, 14, 2),
            Paint(rng.uniform(0, 1, (4, 4)), (0, 0, 0, 1), 1.2),
            1.7,
            rng.uniform(-180, 180),
        ),
        polygon(
            triangle_centre + np.array([[-4, -4], [6, -1], [1, 6]]), Paint(TRANSLUCENT_BLUE, RED, 1.1, join="round")
        ),
        Path((Outline(curve, (3, 2), closed=False),), Paint(None, RED, 2.1, "round", "round")),
        Path((Outline(leaf, (2, 3)),), Paint(rng.uniform(0, 1, (4, 4)), rule="evenodd")),
    ]
    return Vector(32, 32, shapes, (0.2, 0.3, 0.4), **options)


@parametrize_with_checks(
    [
        RendererSubject(scene(seed, dtype=dtype, encoding=encoding), seed=seed, rtol=rtol)
        for seed, dtype, encoding, rtol in ((0, "float64", "linear", 1e-5), (1, "float32", "sRGB", 2e-2))
    ]
)
def test_the_vector_renderer_passes_the_conformance_kit(check: Any, subject: Any) -> None:
    check(subject)


def test_scene_files_can_name_the_vector_renderer() -> None:
    assert scene().capabilities.project is not None
    assert "vector-torch" in {info.name for info in available_renderers()}


@given(seed=SEEDS)
def test_vector_gradients_equal_central_differences(seed: int) -> None:
    """Each parameter moves along a random direction, almost surely without an edge that enters another pixel."""
    renderer = scene(seed)
    rng = np.random.default_rng(seed)
    params = renderer.parameters()
    weights = torch.as_tensor(rng.standard_normal((32, 32, 3)))
    gradient = renderer.render_vjp(params)[1](weights)
    for name, value in params.items():
        direction = torch.as_tensor(rng.standard_normal(value.shape))
        step = 1e-7
        upper, lower = (
            float(torch.sum(weights * renderer.render({**params, name: value + sign * step * direction})))
            for sign in (1.0, -1.0)
        )
        slope = float(torch.sum(gradient[name] * direction))
        scale = float(torch.linalg.vector_norm(gradient[name]) * torch.linalg.vector_norm(direction))
        # The tolerance covers rounding of the sum, and a kink within the step, where an edge enters another pixel.
        assert abs((upper - lower) / (2.0 * step) - slope) <= 1e-3 * scale + 1e-5, name


def painted_area(shape: Any, shift: Any = (0.0, 0.0), size: int = 40) -> float:
    """Return the sum over the red channel of a shape on black, in pixels for a white shape."""
    renderer = Vector(size, size, [shape], BLACK)
    params = renderer.parameters()
    params["positions"] = params["positions"] + torch.as_tensor(np.asarray(shift, dtype=np.float64))
    return float(renderer.render(params)[..., 0].sum())


AREAS = {
    "circle": (Circle([20.0, 20.0], 7.3, WHITE), np.pi * 7.3**2),
    "ellipse": (Ellipse([20.0, 20.0], [9.1, 3.2], WHITE, 33.0), np.pi * 9.1 * 3.2),
    "rectangle": (Rectangle([20.0, 20.0], [15.0, 8.0], WHITE, 0.0, 21.0), 120.0),
    "rounded": (Rectangle([20.0, 20.0], [15.0, 8.0], WHITE, 2.5, 21.0), 120.0 - (4.0 - np.pi) * 2.5**2),
    "triangle": (polygon([[12.0, 12.0], [30.0, 17.0], [18.0, 29.0]], WHITE), 0.5 * (18 * 17 - 5 * 6)),
    "ring": (Circle([20.0, 20.0], 9.0, Paint(None, (1, 1, 1, 1), 3.0)), 2.0 * np.pi * 9.0 * 3.0),
    "line": (polygon([[8.0, 9.0], [20.0, 14.0]], Paint(None, (1, 1, 1, 1), 2.5), closed=False), 13.0 * 2.5),
    "round line": (
        polygon([[8.0, 9.0], [20.0, 14.0]], Paint(None, (1, 1, 1, 1), 2.5, "round"), closed=False),
        13.0 * 2.5 + np.pi * 1.25**2,
    ),
    "square line": (
        polygon([[8.0, 9.0], [20.0, 14.0]], Paint(None, (1, 1, 1, 1), 2.5, "square"), closed=False),
        13.0 * 2.5 + 2.5**2,
    ),
    "frame": (Rectangle([20.0, 20.0], [15.0, 8.0], Paint(None, (1, 1, 1, 1), 2.0), 0.0, 21.0), 17.0 * 10 - 13 * 6),
    "parabola": (Path((Outline([[8.0, 30.0], [20.0, 6.0], [32.0, 30.0]], (2,), closed=False),), WHITE), 192.0),
}


@pytest.mark.parametrize("name", AREAS)
def test_painted_areas_of_shapes_equal_geometric_areas(name: str) -> None:
    shape, area = AREAS[name]
    # A polygon's area is exact. A curve's area has an error up to the tolerance of 0.01 px times the outline's length.
    length = 0.0 if name in ("rectangle", "triangle", "line", "square line", "frame") else 100.0
    assert painted_area(shape) == pytest.approx(area, rel=1e-12, abs=0.01 * length)


@given(seed=SEEDS, name=st.sampled_from(sorted(AREAS)))
def test_painted_areas_do_not_depend_on_positions_between_pixels(seed: int, name: str) -> None:
    shift = np.random.default_rng(seed).uniform(-3.0, 3.0, 2)
    assert painted_area(AREAS[name][0], shift) == pytest.approx(painted_area(AREAS[name][0]), rel=1e-9)


@given(seed=SEEDS)
def test_coverage_of_a_rectangle_equals_the_mean_of_many_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, sides, angle = rng.uniform(0.0, 16.0, 2), rng.uniform(1.0, 14.0, 2), rng.uniform(-180.0, 180.0)
    image = Vector(16, 16, [Rectangle(centre, sides, WHITE, 0.0, angle)], BLACK)
    fine = (np.arange(16 * 32) + 0.5) / 32
    x, y = fine[None, :] - centre[0], fine[:, None] - centre[1]
    cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    is_inside = (np.abs(cos * x + sin * y) < 0.5 * sides[0]) & (np.abs(cos * y - sin * x) < 0.5 * sides[1])
    sampled = is_inside.reshape(16, 32, 16, 32).mean(axis=(1, 3))
    # An edge misclassifies at most about one row of the 32 x 32 samples, and a pixel may contain two edges.
    np.testing.assert_allclose(image.render(image.parameters())[..., 0], sampled, rtol=0, atol=2.0 / 32)


@given(seed=SEEDS)
def test_circles_of_the_vector_renderer_equal_disks_of_the_core(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, radii, colours = rng.uniform(-2, 26, (6, 2)), rng.uniform(0.5, 7, 6), rng.uniform(0, 1, (6, 3))
    disks = Disks(20, 24, positions, radii, colours, (0.2, 0.3, 0.4))
    circles = [
        Circle(centre, radius, Paint((*colour, 1.0)))
        for centre, radius, colour in zip(positions, radii, colours, strict=True)
    ]
    renderer = Vector(20, 24, circles, (0.2, 0.3, 0.4))
    # Chords are within 0.01 px of a circle, cross a pixel along at most sqrt(2) px, and few disks share a pixel.
    expected = disks.render(disks.parameters())
    np.testing.assert_allclose(renderer.render(renderer.parameters()), expected, rtol=0, atol=0.03)


@pytest.mark.parametrize("encoding", ["linear", "sRGB"])
def test_the_brightness_of_a_rectangle_is_constant_at_positions_between_pixels(encoding: str) -> None:
    """A fit from far away would otherwise follow the variation of the brightness instead of the target."""
    renderer = Vector(24, 32, [Rectangle([12.0, 10.0], [9.0, 4.0], Paint((0.9, 0.2, 0.05, 0.7)))], encoding=encoding)
    params = renderer.parameters()
    sums = [
        float(renderer.render(params | {"positions": params["positions"] + float(shift)}).sum())
        for shift in np.linspace(0.0, 1.0, 9)
    ]
    assert np.ptp(sums) < 1e-9 * np.mean(sums)


def test_later_shapes_are_composited_over_earlier_shapes_by_their_opacity() -> None:
    under = Rectangle([4.0, 4.0], [4.0, 4.0], Paint((1.0, 0.0, 0.0, 1.0)))
    over = Rectangle([4.0, 4.0], [2.0, 2.0], Paint((0.0, 1.0, 0.0, 0.25)))
    image = Vector(8, 8, [under, over], BLACK)
    np.testing.assert_allclose(image.render(image.parameters())[4, 4], [0.75, 0.25, 0.0], atol=1e-12)
    swapped = Vector(8, 8, [over, under], BLACK)
    np.testing.assert_allclose(swapped.render(swapped.parameters())[4, 4], [1.0, 0.0, 0.0], atol=1e-12)


def test_opposite_orientation_or_the_evenodd_rule_makes_a_hole() -> None:
    square = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 9.0]])
    inner = np.array([[3.0, 3.0], [7.0, 3.0], [7.0, 7.0], [3.0, 7.0]])
    for hole, rule, area in ((inner, "nonzero", 64.0), (inner[::-1], "nonzero", 48.0), (inner, "evenodd", 48.0)):
        outlines = tuple(Outline(points, (1, 1, 1, 1)) for points in (square, hole))
        shape = Path(outlines, Paint((1, 1, 1, 1), rule=rule))  # type: ignore[arg-type]  # literals of a loop
        assert painted_area(shape) == pytest.approx(area, rel=1e-12)


def test_a_bilinear_fill_is_mixed_in_the_encoding_of_the_image() -> None:
    corners = np.ones((4, 4)) * np.array([0.0, 1.0, 0.0, 1.0])[:, None]  # black on the left, white on the right
    corners[:, 3] = 1.0
    for encoding in ("linear", "sRGB"):
        renderer = Vector(41, 41, [Rectangle([20.5, 20.5], [41.0, 41.0], Paint(corners))], BLACK, encoding=encoding)
        row = renderer.render(renderer.parameters())[20, :, 0]
        np.testing.assert_allclose(row, (np.arange(41) + 0.5) / 41, atol=1e-12)


def test_a_bilinear_fill_has_its_colours_at_the_corners_and_their_mean_in_the_middle() -> None:
    corners = np.random.default_rng(3).uniform(0, 1, (4, 4))
    corners[:, 3] = 1.0
    image = Vector(41, 41, [Rectangle([20.5, 20.5], [41.0, 41.0], Paint(corners))], BLACK)
    picture = image.render(image.parameters()).numpy()
    np.testing.assert_allclose(picture[20, 20], corners[:, :3].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(picture[[0, 0, -1, -1], [0, -1, 0, -1]], corners[:, :3], atol=2.0 / 41)


DEGENERATE: dict[str, Any] = {
    "no radius": Circle([8.0, 8.0], 0.0, Paint(RED, RED, 1.0)),
    "no sides": Rectangle([8.0, 8.0], [0.0, 0.0], Paint(np.ones((4, 4)), RED, 1.0), 0.0),
    "no width": Circle([8.0, 8.0], 3.0, Paint(None, RED, 0.0)),
    "one point": polygon([[8.0, 8.0]] * 3, Paint(np.ones((4, 4)), RED, 1.0, "round", "round")),
    "repeated points": polygon([[3.0, 3.0], [3.0, 3.0], [9.0, 4.0], [9.0, 4.0]], Paint(RED, RED, 1.0, join="round")),
    "a line back to its start": polygon([[3.0, 3.0], [9.0, 4.0], [3.0, 3.0]], Paint(None, RED, 2.0), closed=False),
    "a cusp": Path((Outline([[3, 3], [13, 13], [3, 13], [13, 3]], (3,), closed=False),), Paint(None, RED, 4.0)),
    "a stroke wider than the shape": Circle([8.0, 8.0], 1.0, Paint(None, RED, 5.0)),
    "on the grid": Rectangle([8.0, 8.0], [4.0, 4.0], Paint(RED)),
    "out of frame": Circle([-50.0, 8.0], 3.0, Paint(RED, RED, 1.0)),
    "around the frame": Circle([8.0, 8.0], 1e6, Paint(RED, RED, 1.0)),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_images_and_gradients_of_degenerate_shapes_are_finite(name: str) -> None:
    renderer = Vector(16, 16, [DEGENERATE[name]])
    image, pullback = renderer.render_vjp(renderer.parameters())
    assert torch.isfinite(image).all()
    for value in pullback(torch.as_tensor(np.random.default_rng(1).standard_normal((16, 16, 3)))).values():
        assert torch.isfinite(value).all()


def test_a_stroke_wider_than_its_circle_is_a_disk() -> None:
    assert painted_area(Circle([20.0, 20.0], 2.0, Paint(None, (1, 1, 1, 1), 12.0))) == pytest.approx(
        np.pi * 8.0**2, rel=0.01
    )


def test_an_edge_between_pixels_has_a_gradient_from_the_pixels_that_it_enters() -> None:
    renderer = Vector(8, 8, [Rectangle([4.0, 4.0], [4.0, 4.0], WHITE)], BLACK)
    weights = torch.zeros((8, 8, 3), dtype=torch.float64)
    weights[2:6, 6, 0] = 1.0  # pixels to the right of the edge
    gradient = renderer.render_vjp(renderer.parameters())[1](weights)
    assert float(gradient["positions"][0, 0]) == pytest.approx(4.0)


def test_vector_projection_gives_legal_parameters_and_leaves_its_argument_unchanged() -> None:
    renderer = scene()
    wild = {name: 9.0 * torch.randn(value.shape, dtype=value.dtype) for name, value in renderer.parameters().items()}
    copies: dict[str, Host] = {name: value.numpy().copy() for name, value in wild.items()}
    legal = renderer.project(wild)
    assert (legal["sizes"] > 0.0).all()
    assert (legal["widths"] > 0.0).all()
    assert float(legal["sizes"][0, 0]) == float(legal["sizes"][0, 1])
    assert all(((legal[name] >= 0.0) & (legal[name] <= 1.0)).all() for name in ("fills", "blends", "strokes"))
    for name, value in copies.items():
        np.testing.assert_array_equal(wild[name], value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Vector(8, 8), "`shapes` and `svg` exclude each other"),
        (lambda: Vector(8, 8, svg=cast("Any", 3)), "`svg` must be the path of an SVG file, got 3"),
        (lambda: Vector(8, 8, []), "`shapes` must be a list of at least one shape"),
        (
            lambda: Vector(8, 8, ["circle"]),  # type: ignore[list-item]
            "`shapes` must be Circle, Ellipse, Rectangle or Path, got 'circle'",
        ),
        (lambda: Vector(8, 8, [Circle([1, 1], 1, WHITE)], encoding="gamma"), "`encoding` must be 'linear' or 'sRGB'"),
        (lambda: Circle([1, 1], -1, WHITE), "`radius` must be 0 or more, got -1"),
        (lambda: Paint(), "a shape needs a `fill`, a `stroke` or both"),
        (lambda: Paint(RED, cap="pointed"), "`cap` must be one of butt, round, square, got 'pointed'"),  # type: ignore[arg-type]
        (lambda: Outline([[0, 0]], (4,)), "`degrees` must be 1, 2 or 3"),
        (lambda: painted_area(Circle([1, 1], 1e12, WHITE)), "shapes must lie within 1e\\+09 pixels"),
        (lambda: Vector(4096, 4096, [Circle([0, 0], 9e3, WHITE)] * 9).render({}), "`params` must have exactly"),
        (lambda: painted_area(Circle([0, 0], 1e5, WHITE), size=16384), "more than the 134217728 that are painted"),
    ],
)
def test_errors_of_the_vector_renderer_name_wrong_values(make: Any, message: str) -> None:
    with pytest.raises((OptionError, ParameterError), match=message):
        make()

"""Tests of meshes on torch: exact areas, gradients equal to differences of the image, and degenerate triangles."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from loi_core import LOIObjective, available_renderers, fit
from loi_core.errors import BackendNotFoundError, OptionError, ParameterError
from loi_core.fitting.loop import Free
from loi_core.testing import RendererSubject, parametrize_with_checks
from loi_torch.mesh import (
    Camera,
    Environment,
    Light,
    Material,
    Mesh,
    MeshRenderer,
    MeshWarning,
    Rotate,
    Scale,
    Translate,
    box,
    draw,
    draw_positions,
    quad,
    sphere,
    visibility,
)
from loi_torch.mesh.textures import MipPyramid
from tests.helpers import Host
from tests.strategies import SEEDS

SIZE = 24
FRONT = Camera((0.5 * SIZE, -0.5 * SIZE, 10.0), (0.5 * SIZE, -0.5 * SIZE, 0.0), extent=SIZE)
"""One unit is a pixel, and (x, -y) in world units is (x, y) in the image."""
VIEW = Camera((0.13, 0.4, 5.0))
LIT = [Light()]


def flat_mesh(points: Any, depth: float = 0.0, **options: Any) -> Mesh:
    """Return a mesh of separate triangles, three points each, in pixels of `FRONT`."""
    points = np.reshape(points, (-1, 2))
    corners = np.column_stack([points[:, 0], -points[:, 1], np.full(len(points), depth)])
    return Mesh(corners, np.arange(len(points)).reshape(-1, 3), **{"colours": (1.0, 1.0, 1.0), **options})


def clipped_area(triangle: Host, row: int, column: int) -> float:
    """Return the area of a triangle within a pixel, clipped at the pixel's sides (Sutherland and Hodgman)."""
    points = list(triangle)
    for axis, limit, sign in ((0, column, 1), (0, column + 1, -1), (1, row, 1), (1, row + 1, -1)):
        clipped = []
        for k, point in enumerate(points):
            previous = points[k - 1]
            is_inside, was_inside = (sign * (corner[axis] - limit) >= 0 for corner in (point, previous))
            if is_inside != was_inside:
                fraction = (limit - previous[axis]) / (point[axis] - previous[axis])
                clipped.append(previous + fraction * (point - previous))
            if is_inside:
                clipped.append(point)
        points = clipped
    if not points:
        return 0.0
    x, y = np.array(points).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def intersecting_meshes(offsets: Any) -> list[Mesh]:
    """Return a sphere and a rotated box of six colours, which intersect; `offsets` has shape (6,)."""
    colours = np.array([[1, 0.2, 0.1], [0.1, 0.9, 0.2], [0.2, 0.3, 1], [1, 1, 0.1], [0.1, 1, 1], [1, 0.2, 1]])
    ball = sphere(0.7, subdivisions=2, colours=(0.9, 0.6, 0.3), material=Material(specular=0.0))
    cube = box((1.2, 1.2, 1.2), colours=np.repeat(colours, 2, axis=0), per="triangle")
    rotation = torch.tensor([[0.8, -0.6, 0.0], [0.48, 0.64, -0.6], [0.36, 0.48, 0.8]], dtype=torch.float64)
    return [
        replace(ball, vertices=ball.vertices + offsets[:3]),
        replace(cube, vertices=cube.vertices @ rotation.T + offsets[3:]),
    ]


OFFSETS = torch.tensor([0.3, 0.1, 0.1, -0.25, 0.05, -0.1], dtype=torch.float64)


def gradient_and_differences(
    render: Callable[[Tensor], Tensor], start: Tensor, weights: Tensor, step: float
) -> tuple[Host, Host]:
    """Return the gradient of a weighted sum over the image, and its central differences."""
    leaf = start.clone().requires_grad_()
    (render(leaf) * weights).sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    differences = [
        float(((render(start + offset) - render(start - offset)) * weights).sum() / (2.0 * step))
        for offset in step * torch.eye(len(start), dtype=torch.float64)
    ]
    return leaf.grad.numpy(), np.array(differences)


def smooth_weights(size: int, seed: int = 0) -> Tensor:
    coarse = torch.from_numpy(np.random.default_rng(seed).normal(size=(1, 3, 6, 6)))
    return torch.nn.functional.interpolate(coarse, (size, size), mode="bicubic")[0].movedim(0, 2)


# Coverage.


@given(SEEDS, st.sampled_from([0.3, 1.5, 8.0]))
@settings(max_examples=25)
def test_a_triangle_covers_its_exact_area_of_every_pixel(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    triangle = rng.uniform(6.0, 18.0, 2) + rng.normal(0.0, size, (3, 2))
    image = draw([flat_mesh(triangle)], FRONT, SIZE, SIZE).numpy()
    exact = np.zeros((SIZE, SIZE, 1))
    lower, upper = np.floor(triangle.min(axis=0)).astype(int), np.ceil(triangle.max(axis=0)).astype(int)
    (left, top), (right, bottom) = np.clip((lower, upper), 0, SIZE)
    for row, column in itertools.product(range(top, bottom), range(left, right)):
        exact[row, column] = clipped_area(triangle, row, column)
    np.testing.assert_allclose(image, np.repeat(exact, 3, axis=2), atol=2e-4)


@given(SEEDS)
@settings(max_examples=15)
def test_the_brightness_of_a_shape_does_not_depend_on_its_position_between_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ball = sphere(5.3, subdivisions=3, colours=(1.0, 1.0, 1.0))
    position = rng.uniform([9.0, -15.0, -1.0], [15.0, -9.0, 1.0])
    sums = [
        float(draw([replace(ball, vertices=ball.vertices + torch.as_tensor(centre))], FRONT, SIZE, SIZE).sum())
        for centre in (position, position + np.append(rng.uniform(-1.0, 1.0, 2), 0.0))
    ]
    assert sums[1] == pytest.approx(sums[0], rel=2e-6)


@pytest.mark.parametrize("shift", [0.0, 0.5, 0.25])
def test_edges_along_borders_and_through_centres_of_pixels_cover_exact_areas(shift: float) -> None:
    square = np.array([[8, 8], [16, 8], [16, 16], [8, 8], [16, 16], [8, 16]]) + shift
    image = draw([flat_mesh(square)], FRONT, SIZE, SIZE)[..., 0].numpy()
    line = np.clip(np.minimum(np.arange(SIZE) + 1, 16 + shift) - np.maximum(np.arange(SIZE), 8 + shift), 0.0, 1.0)
    np.testing.assert_allclose(image, np.outer(line, line), atol=1e-5)


def test_adjacent_triangles_leave_neither_gap_nor_overlap() -> None:
    rng = np.random.default_rng(0)
    centre = rng.uniform(2.0, 22.0, 2)
    ring = [(0, 0), (24, 0), (24, 24), (0, 24)]
    fan = [(ring[k], ring[(k + 1) % 4], centre) for k in range(4)]
    image = draw([flat_mesh(fan)], FRONT, SIZE, SIZE)
    np.testing.assert_allclose(image.numpy(), 1.0, atol=1e-12)


@given(SEEDS)
@settings(max_examples=10)
def test_the_image_equals_a_plain_depth_buffer_away_from_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners, colours = rng.uniform(0.0, SIZE, (8, 3, 2)), rng.uniform(size=(8, 3))
    depths = rng.uniform(-2.0, 2.0, (8, 3))
    triangles = np.concatenate([corners * [1, -1], depths[..., None]], axis=2).reshape(-1, 3)
    soup = Mesh(triangles, np.arange(24).reshape(8, 3), colours=colours, per="triangle")
    image = draw([soup], FRONT, SIZE, SIZE).numpy()
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    buffer, expected = np.full((SIZE, SIZE), -np.inf), np.zeros((SIZE, SIZE, 3))
    close_to_edge = np.zeros((SIZE, SIZE), bool)
    for triangle, corner_depths, colour in zip(corners, depths, colours, strict=True):
        a, b, c = triangle
        functions = []
        for p, q in ((b, c), (c, a), (a, b)):
            value = (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            close_to_edge |= np.abs(value) < 0.8 * np.linalg.norm(q - p)
            functions.append(value)
        weights = np.stack(functions) / sum(functions)
        depth = np.tensordot(corner_depths, weights, 1)
        is_covered = (weights >= 0).all(axis=0)
        in_front = is_covered & (depth > buffer)
        close_to_edge |= is_covered & (np.abs(depth - buffer) < 0.8)  # triangles may intersect there
        buffer[in_front], expected[in_front] = depth[in_front], colour
    np.testing.assert_allclose(image[~close_to_edge], expected[~close_to_edge], atol=1e-12)


def test_an_image_is_the_mean_of_a_fine_image_up_to_shading_within_pixels() -> None:
    coarse = draw(intersecting_meshes(OFFSETS), VIEW, 32, 32, lights=LIT)
    fine = draw(intersecting_meshes(OFFSETS), VIEW, 256, 256, lights=LIT).reshape(32, 8, 32, 8, 3).mean(dim=(1, 3))
    difference = (coarse - fine).abs()
    assert float(difference.mean()) < 1e-3
    assert float(difference.max()) < 0.12


# Gradients.


def ball_and_box(camera: Camera, dtype: str, parameters: dict[str, Any]) -> MeshRenderer:
    """Return a renderer of a ball that a box partly occludes."""
    meshes = {"ball": sphere(subdivisions=2, colours=(0.9, 0.4, 0.2)), "box": box((1, 1, 1), (1.0, 0.0, 1.9))}
    return MeshRenderer(24, 32, meshes, camera, parameters, dtype=dtype)


POSES: dict[str, Any] = {
    "position": Translate("ball"),
    "rotation": Rotate("box"),
    "angle": Rotate("ball", (0, 1, 0), (1, 0, 0)),
    "size": Scale("box"),
}
APPEARANCE: dict[str, Any] = {
    "colour": "ball.colours",
    "eye": "camera.position",
    "light": "light.colour",
    "matte": "box.diffuse",
}


@parametrize_with_checks(
    [
        RendererSubject(ball_and_box(VIEW, "float64", POSES | APPEARANCE)),
        RendererSubject(ball_and_box(Camera((0.2, 0.4, 5.0), extent=4.0), "float32", {"position": Translate("ball")})),
    ]
)
def test_mesh_renderers_pass_the_conformance_kit(check: Any, subject: Any) -> None:
    check(subject)


def test_scene_files_can_name_the_mesh_renderer() -> None:
    renderer = MeshRenderer(8, 8, {"ball": sphere(subdivisions=1)}, VIEW, {"position": Translate("ball")})
    assert renderer.capabilities.project == renderer.project
    assert "mesh-torch" in {info.name for info in available_renderers()}


@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_differences_where_outlines_cross_and_meshes_intersect(seed: int) -> None:
    offsets = OFFSETS + torch.as_tensor(np.random.default_rng(seed).normal(0.0, 0.05, 6))
    gradient, differences = gradient_and_differences(
        lambda leaf: draw(intersecting_meshes(leaf), VIEW, 48, 48, lights=LIT), offsets, smooth_weights(48, seed), 1e-6
    )
    np.testing.assert_allclose(gradient, differences, atol=1e-4 * np.abs(differences).max())


@pytest.mark.parametrize(("lights", "first_mesh", "tolerance"), [(LIT, 0, 0.1), ([], 1, 2e-3)], ids=["lit", "unlit"])
def test_gradients_equal_differences_of_a_fine_image_up_to_shading_within_pixels(
    lights: list[Light], first_mesh: int, tolerance: float
) -> None:
    def render(leaf: Tensor, size: int) -> Tensor:
        return draw(intersecting_meshes(leaf)[first_mesh:], VIEW, size, size, lights=lights)

    weights = smooth_weights(48)
    gradient, _ = gradient_and_differences(lambda leaf: render(leaf, 48), OFFSETS, weights, 1e-6)
    fine_weights = weights.repeat_interleave(8, dim=0).repeat_interleave(8, dim=1) / 64.0
    _, differences = gradient_and_differences(lambda leaf: render(leaf, 384), OFFSETS, fine_weights, 2e-3)
    np.testing.assert_allclose(gradient, differences, atol=tolerance * np.abs(differences).max())


def test_a_hidden_mesh_has_no_gradient_and_its_occluder_has() -> None:
    hidden, front = sphere(0.5, (0, 0, -2), 2), quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), colours=(1, 0, 0))
    leaf = torch.zeros((2, 3), dtype=torch.float64, requires_grad=True)
    meshes = [replace(hidden, vertices=hidden.vertices + leaf[0]), replace(front, vertices=front.vertices + leaf[1])]
    (draw(meshes, VIEW, 32, 32) * smooth_weights(32)).sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    assert torch.equal(leaf.grad[0], torch.zeros(3, dtype=torch.float64))
    assert bool((leaf.grad[1] != 0.0).all())


# Surfaces and light.


def test_vertex_colours_are_interpolated_in_space_and_not_on_the_screen() -> None:
    floor = quad(
        (-2, -1, 2), (2, -1, 2), (2, -1, -20), (-2, -1, -20), colours=[[0, 0, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]]
    )
    image = draw([floor], Camera((0, 1, 5), (0, 1, 0), fov=90.0), 40, 40)[:, 20, 0].numpy()
    rows = np.arange(24, 33)
    depth = 2.0 / ((rows + 0.5 - 20.0) / 20.0)  # distance from the eye to the floor along the row's ray
    np.testing.assert_allclose(image[rows], (depth - 3.0) / 22.0, atol=1e-12)


def test_a_texture_is_bilinear_if_close_and_its_mean_if_far_away() -> None:
    checks = (np.indices((64, 64)).sum(axis=0) % 2.0)[..., None] * np.ones(3)
    picture = quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), texture=checks)
    sharp = draw([picture], Camera((0, 0, 1), extent=2.0), 64, 64)
    np.testing.assert_allclose(sharp.numpy(), checks[::1], atol=1e-9)
    mean = draw([picture], Camera((0, 0, 1), extent=2.0), 8, 8)
    np.testing.assert_allclose(mean.numpy(), 0.5, atol=1e-9)
    leaf = torch.as_tensor(checks).requires_grad_()
    draw([replace(picture, texture=leaf)], Camera((0, 0, 1), extent=2.0), 8, 8).sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    np.testing.assert_allclose(leaf.grad.numpy(), 1.0 / 64.0, atol=1e-9)  # every texel has the same weight


def test_a_mirror_shows_the_environment_in_the_reflected_direction() -> None:
    glass = quad((-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0), material=Material(0.0, 0.0, 0.0, 1.0))
    faces = np.zeros((6, 4, 4, 3)) + np.linspace(0.1, 0.6, 6)[:, None, None, None]
    camera = Camera((0, 0, 5), extent=4.0)
    image = draw([glass], camera, 6, 6, environment=Environment(faces))
    np.testing.assert_allclose(image.numpy(), 0.5, atol=1e-12)  # +z, the direction of the camera
    tilted = Camera((5, 0, 1), extent=1.0)
    np.testing.assert_allclose(draw([glass], tilted, 6, 6, environment=Environment(faces))[3, 3].numpy(), 0.2)  # -x
    rows = np.linspace(0.0, 1.0, 16)[:, None, None] * np.ones((16, 32, 3))  # dark at +y, bright at -y
    above = Camera((0, 5, 0), up=(0, 0, -1), extent=2.0)
    floor = replace(glass, vertices=glass.vertices[:, [0, 2, 1]] * torch.tensor([1.0, 1.0, -1.0]))
    up = draw([floor], above, 6, 6, environment=Environment(rows))
    np.testing.assert_allclose(up.numpy(), 0.0, atol=1e-9)


def test_reflected_light_equals_the_formula_of_blinn_and_phong() -> None:
    wall = quad((-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0), colours=(0.5, 0.5, 0.5))
    material = Material(ambient=0.1, diffuse=0.6, specular=0.3, shininess=5.0)
    lights = [Light(direction=(0.0, -0.6, -0.8))]
    image = draw([replace(wall, material=material)], Camera((0, 0, 5), extent=4.0), 4, 4, lights=lights)
    halfway = np.array([0.0, 0.6, 1.8]) / np.linalg.norm([0.0, 0.6, 1.8])
    np.testing.assert_allclose(image.numpy(), 0.5 * (0.1 + 0.6 * 0.8) + 0.3 * halfway[2] ** 5, atol=1e-12)


def test_drawn_positions_move_with_the_surface() -> None:
    ball = sphere(subdivisions=2)
    leaf = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    image = draw_positions([replace(ball, vertices=ball.vertices + leaf)], VIEW, 32, 32)
    y, x = (np.indices((32, 32)) + 0.5) / 32
    np.testing.assert_allclose(image[..., 3:].detach().numpy(), np.stack([x, y], axis=-1), atol=1e-12)
    (image[..., 3].sum() / (image[..., 0] > 0.0).sum()).backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    # The visible side of the ball is about 4 units away, so it moves by about 1 / (2 * 4 * tan 22.5 degrees) images.
    assert float(leaf.grad[0]) == pytest.approx(1.0 / (2.0 * 4.3 * np.tan(np.radians(22.5))), rel=0.1)


# Degenerate and large meshes.


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[0, 0, 9], [1, 0, 9], [0, 1, 9]],  # all corners behind the camera
        [[-3, -1, 2], [3, -1, 2], [0, -1, 30]],  # through the camera's plane
        [[0.13, 0.4, 5.0], [1, 0, 0], [0, 1, 0]],  # a corner in the eye
        [[1e9, 0, 0], [0, 1e9, 0], [-1e9, -1e9, 1]],
        [[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0]],
        [[1e-160, 0, 0], [0, 1e-160, 0], [0, 0, 1e-160]],
    ],
)
def test_images_and_gradients_of_degenerate_triangles_are_finite(points: Any) -> None:
    corners = torch.tensor(points, dtype=torch.float64, requires_grad=True)
    image = draw([Mesh(corners, [[0, 1, 2]])], VIEW, 16, 16, lights=LIT)
    assert bool(torch.isfinite(image).all())
    image.sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert corners.grad is not None
    assert bool(torch.isfinite(corners.grad).all())


def test_a_floor_through_the_camera_is_drawn_up_to_the_near_plane() -> None:
    floor = Mesh([[-50, -1, 50], [50, -1, 50], [50, -1, -50], [-50, -1, -50]], [[0, 1, 2], [0, 2, 3]])
    image = draw([floor], Camera((0, 0, 0), (0, 0, -1), fov=90.0), 20, 20)[..., 0].numpy()
    np.testing.assert_allclose(image[11:], 0.8, atol=1e-9)
    np.testing.assert_allclose(image[:10], 0.0, atol=1e-9)


def test_a_fit_of_a_hidden_handle_reports_no_gradient() -> None:
    """The mug hides its handle at the start, where the image does not depend on the handle's angle."""
    mug = box((1.2, 1.8, 1.2), colours=(0.2, 0.4, 0.8))
    handle = box((0.7, 0.8, 0.2), (0.9, 0.0, 0.0), colours=(0.2, 0.4, 0.8))
    parameters = {"angle": Rotate("handle", (0, 1, 0), (0, 0, 0))}
    renderer = MeshRenderer(32, 32, {"mug": mug, "handle": handle}, Camera((0.0, 1.0, 6.0)), parameters)
    photograph = renderer.render({"angle": torch.tensor(-25.0, dtype=torch.float64)})
    result = fit(renderer, LOIObjective(photograph), steps=30, optimise={"angle": Free(90.0)})
    assert result.diagnosis is not None
    assert result.diagnosis.verdict == "no gradient"
    assert "hidden" in result.diagnosis.advice


def test_the_first_of_coplanar_triangles_is_drawn() -> None:
    triangle = [[4, 4], [20, 4], [4, 20]]
    image = draw([flat_mesh(triangle, colours=(1, 0, 0)), flat_mesh(triangle, colours=(0, 1, 0))], FRONT, SIZE, SIZE)
    assert float(image[..., 1].abs().max()) < 1e-6
    assert float(image[..., 0].sum()) == pytest.approx(128.0)


def test_drawing_without_numba_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "loi_torch.mesh.visibility.numba", None)
    monkeypatch.delattr(visibility, "numba", raising=False)
    with pytest.raises(BackendNotFoundError, match=r"meshes need Numba, .*: pip install numba"):
        draw([sphere(subdivisions=1)], VIEW, 4, 4)


def test_an_empty_scene_shows_the_background() -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    for meshes in ([], [empty], [empty, empty]):
        image = draw(meshes, VIEW, 5, 7, background=(0.1, 0.2, 0.3))
        np.testing.assert_allclose(image.numpy(), np.broadcast_to((0.1, 0.2, 0.3), (5, 7, 3)))


def test_a_mesh_of_a_million_triangles_has_finite_gradients() -> None:
    count = 708  # vertices along each side of the grid
    y, x = np.mgrid[:count, :count] / (count - 1.0) * 2.0 - 1.0
    hills = np.stack([x, y, 0.1 * np.sin(3.0 * x) * np.sin(4.0 * y)], axis=-1).reshape(-1, 3)
    a = (np.arange(count * (count - 1)).reshape(count - 1, count)[:, :-1]).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + count], 1), np.stack([a + 1, a + count + 1, a + count], 1)])
    assert len(faces) > 999_000
    corners = torch.from_numpy(hills).requires_grad_()
    image = draw([Mesh(corners, faces)], Camera((0.3, -3.0, 2.0)), 64, 64)
    image.sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert corners.grad is not None
    assert bool(torch.isfinite(corners.grad).all())
    assert 0.1 < float(image.detach().mean()) < 0.5


# Topology and wrong values.


def unwelded(mesh: Mesh) -> Mesh:
    """Return the mesh with separate vertices for each triangle, as in an STL file."""
    return Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(mesh.faces.size).reshape(-1, 3), colours=mesh.colours)


def test_unwelded_vertices_have_the_image_and_gradients_of_welded_vertices() -> None:
    whole = sphere(subdivisions=1, colours=(0.8, 0.5, 0.2))
    split = unwelded(whole)
    shift = torch.from_numpy(0.1 * np.random.default_rng(0).standard_normal(tuple(whole.vertices.shape)))
    moved = replace(split, vertices=split.vertices + shift[whole.faces.ravel()])
    expected = draw([replace(whole, vertices=whole.vertices + shift)], VIEW, SIZE, SIZE)
    torch.testing.assert_close(draw([moved], VIEW, SIZE, SIZE), expected, atol=1e-12, rtol=0.0)

    def vertex_gradient(mesh: Mesh) -> Tensor:
        leaf = mesh.vertices.clone().requires_grad_()
        image = draw([replace(mesh, vertices=leaf)], VIEW, SIZE, SIZE)
        gradient: Tensor = torch.autograd.grad((image * smooth_weights(SIZE)).sum(), leaf)[0]
        return gradient

    split_gradient, whole_gradient = vertex_gradient(split), vertex_gradient(whole)
    sums = torch.zeros_like(whole_gradient).index_add(0, torch.as_tensor(whole.faces.ravel()).long(), split_gradient)
    torch.testing.assert_close(sums, whole_gradient, atol=1e-10, rtol=0.0)
    for vertex in range(len(whole_gradient)):  # equal gradients keep the copies of a vertex together in a fit
        copies = split_gradient[whole.faces.ravel() == vertex]
        torch.testing.assert_close(copies, copies[:1].expand_as(copies), atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        {"faces": sphere(subdivisions=2).faces[::2]},
        {"smooth": False},
        {"colours": np.random.default_rng(1).uniform(size=(320, 3))},
        {"colours": np.random.default_rng(1).uniform(size=(162, 3))},
    ],
    ids=["faces", "smooth", "triangle colours", "vertex colours"],
)
def test_a_mesh_with_replaced_fields_is_drawn_as_a_new_mesh(change: dict[str, Any]) -> None:
    mesh = sphere(subdivisions=2)
    expected = Mesh(**{"vertices": mesh.vertices, "faces": mesh.faces, **change})
    torch.testing.assert_close(
        draw([replace(mesh, **change)], VIEW, SIZE, SIZE, lights=LIT), draw([expected], VIEW, SIZE, SIZE, lights=LIT)
    )


def test_adjacent_triangles_that_face_opposite_ways_give_a_warning() -> None:
    mesh = sphere(subdivisions=1)
    faces = mesh.faces.copy()
    faces[::2] = faces[::2, ::-1]
    with pytest.warns(MeshWarning, match="must run counterclockwise as seen from outside"):
        Mesh(mesh.vertices, faces)


@pytest.mark.parametrize("lights", [(), LIT])
def test_a_mesh_outside_the_frame_has_a_gradient_of_0(lights: Any) -> None:
    position = torch.tensor([90.0, 0.0, 0.0], dtype=torch.float64, requires_grad=True)
    ball = sphere(subdivisions=1)
    for drawer in (draw, draw_positions):
        image = drawer([replace(ball, vertices=ball.vertices + position)], VIEW, SIZE, SIZE, lights=lights)
        (gradient,) = torch.autograd.grad(image.sum(), position)
        assert not gradient.any()


@pytest.mark.parametrize("shape", [(7, 9), (5, 30), (1, 64), (8, 8)])
def test_every_texel_has_the_same_weight_in_the_mean_of_a_texture(shape: tuple[int, int]) -> None:
    texture = torch.from_numpy(np.random.default_rng(3).uniform(size=(*shape, 3))).requires_grad_()
    pyramid = MipPyramid(texture[None], (True, True))
    centre, footprint = torch.full((1, 2), 0.5).double(), torch.ones(1).double()
    mean = pyramid.sample(torch.zeros(1, dtype=torch.int64), centre, footprint)
    torch.testing.assert_close(mean[0], texture.detach().mean(dim=(0, 1)))
    (gradient,) = torch.autograd.grad(mean.sum(), texture)
    torch.testing.assert_close(gradient, torch.full_like(gradient, 1.0 / (shape[0] * shape[1])))


@pytest.mark.parametrize("rows", [[[-1, 1, -1], [1, -1, 1]], [[0, 0, 0], [0, 0, 0]], [[1, 0, 0], [0, 0, 0]]])
def test_parallel_rows_of_a_free_rotation_are_projected_to_a_rotation(rows: Any) -> None:
    renderer = MeshRenderer(8, 8, {"ball": sphere(subdivisions=1)}, VIEW, {"rotation": Rotate("ball")})
    legal = renderer.project({"rotation": torch.tensor(rows, dtype=torch.float64)})
    torch.testing.assert_close(legal["rotation"] @ legal["rotation"].T, torch.eye(2, dtype=torch.float64))
    renderer.render(legal)


def test_a_fit_of_a_bounded_free_rotation_may_have_several_starts() -> None:
    cube = box(colours=np.eye(3).repeat(4, axis=0))
    renderer = MeshRenderer(24, 32, {"cube": cube}, VIEW, {"rotation": Rotate("cube")})
    angle = np.radians(80.0)
    goal = torch.tensor([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0]]).double()
    objective = LOIObjective(renderer.render({"rotation": goal}))
    optimise = {"rotation": Free(np.eye(2, 3), -1.0, 1.0)}
    for seed in range(2):
        assert fit(renderer, objective, optimise=optimise, starts=4, steps=30, seed=seed).diagnosis is not None


def test_a_mesh_renderer_refuses_a_cotangent_of_another_shape() -> None:
    renderer = MeshRenderer(8, 8, {"ball": sphere(subdivisions=1)}, VIEW, {"position": Translate("ball")})
    _, pullback = renderer.render_vjp(renderer.parameters())
    with pytest.raises(ParameterError, match=r"`cotangent` must have the image's shape, \(8, 8, 3\), got \(4, 4, 3\)"):
        pullback(torch.zeros((4, 4, 3)))


def test_vertices_that_are_not_finite_are_refused_by_parameter_name() -> None:
    renderer = MeshRenderer(8, 8, {"ball": sphere(subdivisions=1)}, VIEW, {"corners": "ball.vertices"})
    params = renderer.parameters()
    params["corners"][3, 1] = float("nan")
    with pytest.raises(ParameterError, match=r"`corners` must be finite, got 1"):
        renderer.render(params)
    with pytest.raises(ParameterError, match=r"`vertices` must be finite, got 1 that are not, the first at \(0, 1\)"):
        Mesh([[0, np.nan, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Mesh(np.zeros((3, 3)), [[0, 1, 3]]), r"`faces` must name vertices 0 to 2, got 0 to 3"),
        (lambda: Mesh(np.zeros((3, 2)), [[0, 1, 2]]), r"`vertices` must have shape \(any, 3\), got \(3, 2\)"),
        (lambda: Mesh(np.zeros((3, 3)), [[0.0, 1, 2]]), r"`faces` must be whole numbers"),
        (lambda: sphere(subdivisions=1, colours=np.zeros((5, 3))), r"`colours` must have shape \(3,\), \(42, 3\)"),
        (lambda: sphere(subdivisions=1, texture=np.zeros((4, 4, 3))), "`uv` is missing"),
        (lambda: sphere(subdivisions=9), "`subdivisions` must be a whole number from 0 to 8, got 9"),
        (lambda: Camera((0, 0, 0)), "`target` must not be at `position`"),
        (lambda: Camera((0, 1, 0)), "nor `up` along the viewing direction"),
        (lambda: Camera((0, 0, 1), fov=180.0), "`fov` must be between 0 and 180 degrees, got 180"),
        (lambda: Camera((0, 0, 1), near=0.0), "`near` must be more than 0 in perspective"),
        (lambda: Camera((0, 0, 1), near="1"), "`near` must be a finite number, got '1'"),  # type: ignore[arg-type]
        (lambda: Camera((0, 0, 1), near=np.inf), "`near` must be a finite number, got inf"),
        (lambda: Material(shininess=0.0), "`shininess` must be more than 0, got 0"),
        (lambda: Mesh(np.zeros((3, 3)), [[0, 1, 2], [0, 1]]), r"`faces` must be whole numbers of shape \(m, 3\)"),
        (lambda: Mesh(np.zeros((3, 3), complex), [[0, 1, 2]]), "`vertices` must be numbers"),
        (lambda: replace(sphere(), material={"diffuse": 1}), "`material` must be a Material"),  # type: ignore[arg-type]
        (
            lambda: Mesh(np.zeros((3, 3)), [[0, 1, 2]], uv=np.zeros((3, 2)), texture=np.zeros((0, 4, 3))),
            "`texture` must have at least one texel",
        ),
        (lambda: draw(sphere(), VIEW, 4, 4), "`meshes` must be a list of Mesh"),  # type: ignore[arg-type]
        (lambda: draw([], VIEW, 2.5, 4), "`height` must be a whole number of pixels"),  # type: ignore[arg-type]
        (lambda: draw([], VIEW, 4, 4, lights=Light()), "`lights` must be a list"),  # type: ignore[arg-type]
        (lambda: Camera((0, 0, 1), extent=-1.0), "`extent` must be more than 0, got -1"),
        (lambda: Light((0, 0, 0), (0, 0, 1)), "`position` and `direction` of a light exclude each other"),
        (lambda: Environment(np.zeros((5, 4, 4, 3))), r"must have shape \(6, s, s, 3\) or \(h, w, 3\)"),
        (
            lambda: draw([], VIEW, 4, 4, background=np.zeros((3, 4, 3))),
            r"`background` must have shape \(3,\) or",
        ),
    ],
)
def test_meshes_cameras_and_lights_refuse_wrong_arguments(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": {"a": "ball.weight"}}, r"`parameters\['a'\]` must be one of background, ball\.ambient"),
        ({"parameters": {"a": Translate("bal")}}, r"must move one of the meshes ball, got 'bal'"),
        ({"parameters": {"a": "ball.colours", "b": "ball.colours"}}, "must not set one entry twice, got 'a', 'b'"),
        ({"camera": {"position": [0, 0, 5], "fow": 3}}, r"`camera`: unknown key `fow`; Camera takes position"),
        ({"camera": {"target": [0, 0, 5]}}, "`position` is missing"),
        ({"camera": 3}, "`camera` must be a Camera or a table"),
        ({"meshes": {"light": sphere(subdivisions=1)}}, "must have distinct names without dots, got 'light'"),
        ({"textures": {"cube": np.zeros((2, 2, 3))}}, "`textures` must have names of meshes, ball, got 'cube'"),
        ({"lights": [Light()]}, "`lights` must be a dict of names and lights"),
        ({"background": np.full(3, np.nan)}, "`background` must be finite, got 3"),
        ({"background": np.zeros((4, 3))}, r"`background` must have shape \(3,\) or \(8, 8, 3\), got \(4, 3\)"),
        ({"meshes": {"ball": {"vertices": np.zeros((3, 3))}}}, r"`meshes\['ball'\]`: `faces` is missing"),
        ({"materials": {"ball": {"gloss": 1}}}, r"`materials\['ball'\]`: unknown key `gloss`"),
    ],
)
def test_the_mesh_renderer_refuses_wrong_arguments(options: dict[str, Any], message: str) -> None:
    valid: dict[str, Any] = {
        "meshes": {"ball": sphere(subdivisions=1)},
        "camera": VIEW,
        "parameters": {"position": Translate("ball")},
    }
    with pytest.raises(ParameterError, match=message):
        MeshRenderer(8, 8, **{**valid, **options})


def test_illegal_parameters_are_projected_and_refused_by_name() -> None:
    ball = sphere(subdivisions=1)
    targets: dict[str, Any] = {
        "size": Scale("ball"),
        "rotation": Rotate("ball"),
        "colour": "ball.colours",
        "fov": "camera.fov",
    }
    renderer = MeshRenderer(8, 8, {"ball": ball}, VIEW, targets)
    wild = {
        "size": torch.tensor(-1.0, dtype=torch.float64),
        "rotation": torch.tensor([[2.0, 0.0, 0.0], [1.0, 3.0, 0.0]], dtype=torch.float64),
        "colour": torch.tensor([-0.5, 0.2, 3.0], dtype=torch.float64),
        "fov": torch.tensor(200.0, dtype=torch.float64),
    }
    legal = renderer.project(wild)
    assert float(legal["size"]) == pytest.approx(1e-6)
    np.testing.assert_allclose(legal["rotation"], np.eye(2, 3), atol=1e-15)
    assert legal["colour"].tolist() == [0.0, 0.2, 3.0]
    assert float(legal["fov"]) == 179.0
    with pytest.raises(ParameterError, match=r"`size` must be at least 1e-06, got -1"):
        renderer.render(wild)
    with pytest.raises(ParameterError, match="`rotation` must be two rows that are not parallel"):
        renderer.render({**legal, "rotation": torch.ones((2, 3), dtype=torch.float64)})


def test_a_view_has_another_camera_unless_a_parameter_sets_the_camera() -> None:
    meshes = {"ball": sphere(subdivisions=1, centre=(0.5, 0, 0))}
    renderer = MeshRenderer(16, 16, meshes, VIEW, {"position": Translate("ball")})
    params = renderer.parameters()
    back_view = renderer.with_camera(Camera((0.0, 0.0, -5.0)))
    assert not torch.allclose(renderer.render(params), back_view.render(params))
    back_renderer = MeshRenderer(16, 16, meshes, Camera((0.0, 0.0, -5.0)), {"position": Translate("ball")})
    assert torch.equal(back_renderer.render(params), back_view.render(params))
    with pytest.raises(OptionError, match="`camera` must not replace a camera that the parameter 'eye' sets"):
        MeshRenderer(8, 8, meshes, VIEW, {"eye": "camera.position"}).with_camera(VIEW)


@pytest.mark.parametrize("owner", ["mesh", "camera"])
def test_an_image_is_on_the_device_of_its_mesh_or_else_of_its_camera(owner: str) -> None:
    mesh, camera = box(), VIEW
    if owner == "mesh":
        mesh = replace(replace(mesh, device=torch.device("meta")), colours=(1.0, 0.5, 0.2))
    else:
        camera = replace(camera, device=torch.device("meta"))
    image = draw([mesh], camera, SIZE, SIZE)
    assert image.device.type == "meta"
    assert image.shape == (SIZE, SIZE, 3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("on_gpu", [{"vertices"}, {"position"}, {"colour"}, {"vertices", "position", "colour"}])
def test_gradients_of_a_mixture_of_devices_arrive_on_the_devices_of_the_tensors(on_gpu: set[str]) -> None:
    def image_and_slopes(on_gpu: set[str]) -> tuple[Tensor, dict[str, Tensor]]:
        values = {
            "vertices": box().vertices.detach(),
            "position": VIEW.position,
            "colour": torch.tensor([0.9, 0.5, 0.2]),
        }
        leaves = {
            name: value.detach().to("cuda" if name in on_gpu else "cpu").requires_grad_()
            for name, value in values.items()
        }
        meshes = [replace(box(), vertices=leaves["vertices"])]
        camera = replace(VIEW, position=leaves["position"])
        image = draw(meshes, camera, SIZE, SIZE, lights=[Light(colour=leaves["colour"])])
        slopes = torch.autograd.grad((image * image).sum(), list(leaves.values()))
        return image.detach(), dict(zip(leaves, slopes, strict=True))

    expected, slopes = image_and_slopes(set())
    image, gpu_slopes = image_and_slopes(on_gpu)
    assert torch.equal(image.cpu(), expected)
    for name, slope in gpu_slopes.items():
        assert slope.device.type == ("cuda" if name in on_gpu else "cpu")
        torch.testing.assert_close(slope.cpu(), slopes[name])

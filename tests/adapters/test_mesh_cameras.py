"""Tests of cameras of meshes: projection by matrices, their inverse, their gradients, and matrices that are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from loi_core import read_posed_images
from loi_core.errors import ParameterError
from loi_torch.mesh import Camera, Environment, Light, MeshRenderer, Translate, box, draw, sphere
from tests.environments import ROOT
from tests.helpers import Host
from tests.strategies import FEWER_EXAMPLES, SEEDS

SPARSE = ROOT / "tests" / "data" / "cameras" / "sparse"
HEIGHT, WIDTH = 20, 30
SIZE = 16
EPSILON = float(np.finfo(np.float64).eps)
BALL = sphere(0.8, subdivisions=2, colours=(0.9, 0.5, 0.2))


def random_matrices(seed: int) -> tuple[Host, Host]:
    """Return a camera matrix with skew and an off-centre principal point, and a camera that sees the origin."""
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    fx, fy = rng.uniform(10.0, 40.0, 2)
    intrinsics = np.array([[fx, rng.normal(), rng.uniform(0.0, WIDTH)], [0, fy, rng.uniform(0.0, HEIGHT)], [0, 0, 1]])
    return intrinsics, np.column_stack([rotation, [*rng.normal(size=2), rng.uniform(4.0, 8.0)]])


def projected(intrinsics: Host, world_to_camera: Host, points: Host) -> Host:
    """Return points in pixels, shape (n, 2), by NumPy."""
    homogeneous = (intrinsics @ (world_to_camera[:, :3] @ points.T + world_to_camera[:, 3:])).T
    pixels: Host = homogeneous[:, :2] / homogeneous[:, 2:]
    return pixels


@given(SEEDS)
def test_a_camera_projects_points_as_its_matrices(seed: int) -> None:
    intrinsics, world_to_camera = random_matrices(seed)
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (20, 3))
    corners, _ = Camera.from_matrix(intrinsics, world_to_camera).project(torch.from_numpy(points), HEIGHT, WIDTH)
    pixels = (corners[:, :2] / corners[:, 2:]).numpy()
    expected = projected(intrinsics, world_to_camera, points)
    np.testing.assert_allclose(pixels, expected, atol=64 * EPSILON * np.abs(intrinsics).max())


@given(SEEDS)
def test_a_camera_returns_the_matrices_that_made_it(seed: int) -> None:
    intrinsics, world_to_camera = random_matrices(seed)
    padded = np.eye(4)
    padded[:3, :3] = intrinsics
    camera = Camera.from_matrix(padded, np.vstack([world_to_camera, [0, 0, 0, 1]]))
    assert np.array_equal(camera.intrinsics(HEIGHT, WIDTH).numpy(), intrinsics)
    matrix = camera.world_to_camera().numpy()
    np.testing.assert_allclose(matrix[:3], world_to_camera, atol=64 * EPSILON * np.abs(world_to_camera).max())
    assert matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]


@given(SEEDS)
def test_the_ray_through_a_projected_point_meets_the_point(seed: int) -> None:
    intrinsics, world_to_camera = random_matrices(seed)
    camera = Camera.from_matrix(intrinsics, world_to_camera)
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (20, 3))
    pixels = torch.from_numpy(projected(intrinsics, world_to_camera, points))
    rays = camera.directions(pixels, HEIGHT, WIDTH).numpy()
    expected = points - camera.position.numpy()
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(rays, expected, atol=256 * EPSILON)


@pytest.mark.parametrize(
    "camera",
    [
        Camera((1.0, 2.0, 6.0), (0.2, 0.0, 0.1), fov=40.0),
        Camera((1.0, -2.0, 6.0), up=(0.3, 1.0, 0.2), fov=40.0, principal_point=(10.0, 12.0), skew=1.5),
    ],
)
def test_a_camera_and_its_matrix_form_draw_the_same_image(camera: Camera) -> None:
    ball = sphere(subdivisions=2, colours=(0.9, 0.5, 0.2))
    sky = Environment(np.random.default_rng(0).uniform(size=(4, 8, 3)))
    matrix_form = Camera.from_matrix(camera.intrinsics(HEIGHT, WIDTH), camera.world_to_camera())
    first, second = (
        draw([ball], view, HEIGHT, WIDTH, lights=[Light()], environment=sky, background=sky)
        for view in (camera, matrix_form)
    )
    np.testing.assert_allclose(first.numpy(), second.numpy(), atol=1e-9)  # rounding, times the slope at outlines


@given(SEEDS)
@settings(FEWER_EXAMPLES)
def test_an_image_shows_a_small_square_at_its_projected_position(seed: int) -> None:
    """The centroid of the image of a box is where the matrices project the box's centre, up to perspective."""
    intrinsics, world_to_camera = random_matrices(seed)
    intrinsics[:2, 2] = 0.5 * np.array([WIDTH, HEIGHT])  # keeps the box in the image
    world_to_camera[:, 3] = 0.0, 0.0, 60.0
    intrinsics[:2, :2] *= 10.0
    offset = np.random.default_rng(seed).uniform(-3.0, 3.0, 2)
    intrinsics[:2, 2] += offset
    camera = Camera.from_matrix(intrinsics, world_to_camera)
    image = draw([box((1e-2, 1e-2, 1e-2), colours=(1.0, 1.0, 1.0))], camera, HEIGHT, WIDTH)[..., 0].numpy()
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    centroid = np.array([np.sum(image * x), np.sum(image * y)]) / image.sum()
    np.testing.assert_allclose(centroid, intrinsics[:2, 2], atol=0.5)  # the box is smaller than a pixel


@pytest.mark.parametrize("sheared", [False, True])
def test_an_off_centre_image_is_a_part_of_a_larger_image(sheared: bool) -> None:
    camera = Camera((0.4, 0.3, 5.0), principal_point=(24.0, 20.0), focal=(40.0, 30.0), skew=3.0 if sheared else 0.0)
    cropped = replace(camera, principal_point=(24.0 - 5.0, 20.0 - 3.0))
    meshes = [box(colours=(0.2, 0.6, 0.9))]
    whole, part = draw(meshes, camera, 40, 48), draw(meshes, cropped, 30, 36)
    np.testing.assert_allclose(part.numpy(), whole[3:33, 5:41].numpy(), atol=1e-9)
    assert float(part[..., 2].mean()) > 0.03  # the box is in the image


@pytest.mark.parametrize("name", ["front.png", "side/left.png", "top.png"])
def test_a_mesh_is_drawn_where_the_camera_of_a_photograph_sees_it(name: str) -> None:
    view = read_posed_images(SPARSE)[name]
    camera = Camera.from_matrix(view.intrinsics, view.world_to_camera)
    assert np.array_equal(camera.intrinsics(view.height, view.width).numpy(), view.intrinsics)
    image = draw([sphere(0.5, colours=(1.0, 1.0, 1.0))], camera, view.height, view.width)[..., 0].numpy()
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    centroid = np.array([np.sum(image * x), np.sum(image * y)]) / image.sum()
    # The ball is at the origin, which the camera looks at; the ball's facets are at most 1 % of its radius off.
    np.testing.assert_allclose(centroid, view.intrinsics[:2, 2], atol=0.05)


def test_a_gradient_reaches_both_matrices() -> None:
    intrinsics, world_to_camera = (torch.from_numpy(matrix).requires_grad_() for matrix in random_matrices(3))
    rows, columns = torch.arange(HEIGHT)[:, None, None], torch.arange(WIDTH)[:, None]
    weights = torch.sin(0.3 * rows + 0.2 * columns + torch.arange(3))

    def total(matrix: Any, extrinsics: Any) -> Any:
        return (draw([BALL], Camera.from_matrix(matrix, extrinsics), HEIGHT, WIDTH) * weights).sum()

    total(intrinsics, world_to_camera).backward()
    assert intrinsics.grad is not None
    assert world_to_camera.grad is not None
    slopes, differences = [], []
    step = 1e-6
    with torch.no_grad():
        for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2)):
            change = torch.zeros(3, 3, dtype=torch.float64)
            change[row, column] = step
            slopes.append(intrinsics.grad[row, column])
            difference = total(intrinsics + change, world_to_camera) - total(intrinsics - change, world_to_camera)
            differences.append(difference / (2.0 * step))
        for axis in range(3):
            generator = torch.zeros(3, 3, dtype=torch.float64)
            generator[axis - 2, axis - 1], generator[axis - 1, axis - 2] = -1.0, 1.0
            turn = torch.linalg.matrix_exp(step * generator)
            slopes.append((world_to_camera.grad * (generator @ world_to_camera)).sum())
            difference = total(intrinsics, turn @ world_to_camera) - total(intrinsics, turn.T @ world_to_camera)
            differences.append(difference / (2.0 * step))
    # Triangles of a pixel's size make gradients inexact, as in the tests of meshes.
    np.testing.assert_allclose(slopes, differences, atol=2e-3 * float(np.abs(differences).max()))


def test_the_entries_of_a_matrix_are_parameters_of_a_renderer() -> None:
    camera = Camera.from_matrix(*random_matrices(0))
    targets = {"focal": "camera.focal", "centre": "camera.principal_point", "skew": "camera.skew"}
    renderer = MeshRenderer(HEIGHT, WIDTH, {"ball": BALL}, camera, targets)
    params = renderer.parameters()
    assert {name: tuple(value.shape) for name, value in params.items()} == {"focal": (2,), "centre": (2,), "skew": ()}
    image = renderer.render(params)
    moved = renderer.render({**params, "centre": params["centre"] + 1.0})
    np.testing.assert_allclose(moved[1:, 1:].numpy(), image[:-1, :-1].numpy(), atol=1e-9)
    assert float(renderer.project({**params, "focal": -params["focal"]})["focal"].min()) == pytest.approx(1e-6)
    table = {"position": [0, 0, 5], "focal": [30, 30], "principal_point": [15, 10]}
    from_table = MeshRenderer(HEIGHT, WIDTH, {"ball": BALL}, table, {"position": Translate("ball")})
    expected = draw([BALL], Camera((0, 0, 5), focal=(30, 30)), HEIGHT, WIDTH, lights=[Light()])
    assert torch.equal(from_table.render(from_table.parameters()), expected)


GOOD = [[30.0, 0.0, 15.0], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("intrinsics", "world_to_camera", "message"),
    [
        (np.eye(2), np.eye(4), r"`intrinsics` must have shape \(3, 3\) or \(4, 4\), got \(2, 2\)"),
        (GOOD, np.eye(3), r"`world_to_camera` must have shape \(3, 4\) or \(4, 4\), got \(3, 3\)"),
        (
            np.diag([30.0, 30.0, 2.0]),
            np.eye(4),
            r"`intrinsics` must be \[\[fx, skew, cx\], \[0, fy, cy\], \[0, 0, 1\]\]",
        ),
        (np.diag([30.0, 30.0, 1.0, 2.0]), np.eye(4), "`intrinsics` must have the identity's fourth row and column"),
        (np.diag([30.0, 0.0, 1.0]), np.eye(4), r"`focal` must be more than 0, got \(30.0, 0.0\)"),
        (GOOD, np.full((4, 4), np.nan), "`world_to_camera` must be finite"),
        (GOOD, np.ones((4, 4)), "`world_to_camera` must have the identity's fourth row"),
        (GOOD, np.diag([1.0, 1.0, -1.0, 1.0]), "`world_to_camera` must begin with a rotation matrix"),
        (GOOD, np.diag([2.0, 2.0, 2.0, 1.0]), "`world_to_camera` must begin with a rotation matrix"),
        ("K", np.eye(4), "`intrinsics` must be numbers, got 'K'"),
    ],
)
def test_matrices_of_no_camera_are_refused(intrinsics: Any, world_to_camera: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message) as caught:
        Camera.from_matrix(intrinsics, world_to_camera)
    assert "\n" not in str(caught.value)


def test_an_orthographic_camera_has_neither_focal_lengths_nor_skew() -> None:
    for option in ({"focal": (30.0, 30.0)}, {"skew": 1.0}):
        with pytest.raises(ParameterError, match="must have neither `focal` nor `skew`"):
            Camera((0, 0, 5), extent=3.0, **option)


@given(st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)))
@settings(FEWER_EXAMPLES)
def test_an_orthographic_camera_has_a_principal_point(offset: tuple[float, float]) -> None:
    camera = Camera((0, 0, 5), extent=3.0, principal_point=(15.0 + offset[0], 10.0 + offset[1]))
    corners, _ = camera.project(torch.zeros(1, 3, dtype=torch.float64), HEIGHT, WIDTH)
    np.testing.assert_allclose(corners[0].numpy(), [15.0 + offset[0], 10.0 + offset[1], 1.0], atol=64 * EPSILON)

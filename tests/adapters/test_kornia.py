"""The loss, registration, cameras and poses in kornia's conventions."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from kornia.geometry import ImageRegistrator
from kornia.geometry.camera import PinholeCamera
from kornia.geometry.liegroup import Se3
from kornia.geometry.quaternion import Quaternion
from torch import Tensor
from torch.nn import functional

import loi_torch
from loi_core import ScaleSpace
from loi_core.errors import DerivativeError, ImageError, ParameterError, UnknownOptionError
from loi_core.renderers.poses import PoseParameter
from loi_torch.kornia import LOILoss, RegistrationLoss, loi_loss
from loi_torch.kornia.cameras import cameras_from_pinhole, pinhole_from_cameras, pose_from_values, values_from_pose
from loi_torch.mesh import Camera, Rotate, Translate
from loi_torch.mesh.posing import apply_handles
from tests.environments import run
from tests.strategies import FEWER_EXAMPLES, SEEDS

EPSILON = float(np.finfo(np.float64).eps)
HEIGHT, WIDTH = 12, 14
SIDE = 64
HALF_SIDE = 0.5 * SIDE  # kornia's unit of a shift


def images(seed: int, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    first, second = torch.rand(2, 2, 3, HEIGHT, WIDTH, generator=generator, dtype=dtype)
    return first, second


def mask(seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(2, 1, HEIGHT, WIDTH, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
@pytest.mark.parametrize("options", [{}, {"colours": "differences"}, {"exposure": "matched"}, {"accuracy": "fast"}])
def test_the_loss_equals_that_of_loi_torch_with_channels_first(reduction: Any, options: dict[str, Any]) -> None:
    image, target = images(0)
    expected = loi_torch.loi_loss(image, target, channel_axis=-3, reduction=reduction, **options)
    assert torch.equal(loi_loss(image, target, reduction=reduction, **options), expected)
    assert torch.equal(LOILoss(reduction=reduction, **options)(image, target), expected)


def test_weights_have_the_shape_of_kornias_masks() -> None:
    image, target = images(0)
    weights = mask(1)
    expected = loi_torch.loi_loss(image, target, channel_axis=-3, weights=weights[:, 0])
    assert torch.equal(loi_loss(image, target, weights=weights), expected)
    with pytest.raises(ImageError, match="`weights` must have shape"):
        loi_loss(image, target, weights=weights[:, 0])


@pytest.mark.parametrize("options", [{}, {"colours": "differences"}, {"weights": mask(2)}], ids=str)
def test_gradients_of_both_images_pass_kornias_gradcheck(options: dict[str, Any]) -> None:
    """With the arguments of `BaseTester.gradcheck`, which asks for the gradients of all inputs."""
    inputs = [image.requires_grad_() for image in images(3)]
    options = {name: value if name == "colours" else value.double() for name, value in options.items()}

    def loss(image: Tensor, target: Tensor) -> Tensor:
        return loi_loss(image, target, **options)

    assert torch.autograd.gradcheck(loss, inputs, raise_exception=True, fast_mode=True)


def test_a_target_with_a_fitted_exposure_has_no_gradient() -> None:
    image, target = images(4)
    with pytest.raises(DerivativeError, match="detach"):
        loi_loss(image, target.requires_grad_(), exposure="matched")


def test_images_of_unlike_shapes_are_refused() -> None:
    image, target = images(5)
    for other in (target[:1], target[0], target[:, :1]):
        with pytest.raises(ImageError, match="one shape"):
            loi_loss(image, other)


@pytest.mark.parametrize(
    ("function", "keyword", "meaning"),
    [(loi_loss, "mask", "weights"), (LOILoss, "colors", "colours"), (RegistrationLoss, "scale", "scales")],
)
def test_misspelt_keywords_of_kornias_losses_are_answered_by_their_meaning(
    function: Any, keyword: str, meaning: str
) -> None:
    with pytest.raises(UnknownOptionError, match=f"did you mean `{meaning}`"):
        function(**{keyword: None})


def test_the_loss_alone_does_not_import_kornia() -> None:
    code = "import sys, loi_torch.kornia; print('kornia' in sys.modules)"
    assert run(sys.executable, "-c", code).strip() == "False"


def disk(x: float, y: float) -> Tensor:
    rows, columns = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij")
    coverage = (5.5 - torch.hypot(columns - x, rows - y)).clamp(0.0, 1.0)
    return (0.2 + 0.6 * coverage)[None, None]


def registered_shift(loss: Any) -> Tensor:
    registrator = ImageRegistrator("translation", loss_fn=loss, lr=0.01)
    model = registrator.register(disk(44.0, 42.0), disk(20.0, 23.0))
    assert isinstance(model, Tensor)
    return -HALF_SIDE * model.detach()[0, :2, 2]


def test_a_disk_31_pixels_away_is_registered_where_l1_loses_it() -> None:
    truth = torch.tensor([-24.0, -19.0])
    assert float((registered_shift(RegistrationLoss()) - truth).abs().max()) < 0.3
    assert float((registered_shift(functional.l1_loss) - truth).abs().max()) > 15.0


def translated(image: Tensor, shift: float) -> Tensor:
    theta = torch.tensor([[[1.0, 0.0, shift], [0.0, 1.0, 0.0]]], dtype=image.dtype).requires_grad_()
    grid = functional.affine_grid(theta, list(image.shape), align_corners=False)
    return functional.grid_sample(image, grid, align_corners=False)


def test_the_uncovered_part_of_a_warp_does_not_count() -> None:
    """The target is white where the warp uncovers black, and equal elsewhere."""
    image = images(6)[0][:1]
    warped = translated(image, 2.0 * 4 / WIDTH)  # 4 pixels
    target = warped.detach().clone()
    target[..., -4:] = 1.0
    assert RegistrationLoss()(warped, target).item() == 0.0
    assert loi_loss(warped, target).item() > 0.0


def test_the_loss_of_a_registration_is_the_mean_over_covered_pixels() -> None:
    image, target = (batch[:1] for batch in images(7))
    warped = translated(image, 2.0 * 4 / WIDTH)
    covered = torch.ones(1, 1, HEIGHT, WIDTH, dtype=image.dtype)
    covered[..., -4:] = 0.0
    expected = loi_loss(warped, target, ScaleSpace.for_image(HEIGHT, WIDTH), weights=covered) / covered.mean()
    value = RegistrationLoss()(warped, target)
    assert value.shape == (1, 1, 1, 1)
    torch.testing.assert_close(value.reshape(()), expected)


def test_a_warp_out_of_the_frame_leaves_the_gradient_finite() -> None:
    image = images(8)[0][:1].requires_grad_()
    RegistrationLoss()(translated(image, 3.0), images(8)[1][:1]).sum().backward()
    assert image.grad is not None
    assert torch.equal(image.grad, torch.zeros_like(image))


def test_the_scales_are_those_of_each_level_of_the_pyramid() -> None:
    sizes = []

    def scales(height: int, width: int) -> ScaleSpace:
        sizes.append((height, width))
        return ScaleSpace.for_image(height, width)

    registrator = ImageRegistrator("translation", loss_fn=RegistrationLoss(scales), pyramid_levels=2, num_iterations=1)
    registrator.register(disk(30.0, 30.0), disk(32.0, 30.0))
    assert sizes == [(32, 32), (32, 32), (64, 64), (64, 64)]


def test_an_image_without_the_graph_of_a_warp_is_refused() -> None:
    image, target = images(9)
    for warped in (image, image.requires_grad_() * 1.0):
        with pytest.raises(ImageError, match="grid_sample"):
            RegistrationLoss()(warped, target)


def random_pinhole(seed: int, batch: int) -> PinholeCamera:
    rng = np.random.default_rng(seed)
    intrinsics, extrinsics = np.zeros((2, batch, 4, 4)) + np.eye(4)
    for index in range(batch):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        extrinsics[index, :3, :3] = rotation * np.sign(np.linalg.det(rotation))
        extrinsics[index, :3, 3] = [*rng.normal(size=2), rng.uniform(4.0, 8.0)]
        intrinsics[index, [0, 1], [0, 1]] = rng.uniform(10.0, 40.0, 2)
        intrinsics[index, :2, 2] = rng.uniform(0.0, 30.0, 2)
    sizes = (torch.full((batch,), size, dtype=torch.float64) for size in (HEIGHT, WIDTH))
    return PinholeCamera(torch.from_numpy(intrinsics), torch.from_numpy(extrinsics), *sizes)


@given(SEEDS, st.integers(1, 3))
@FEWER_EXAMPLES
def test_a_camera_projects_as_kornias_whose_pixels_have_whole_numbers_at_their_centres(seed: int, batch: int) -> None:
    pinhole = random_pinhole(seed, batch)
    points = torch.from_numpy(np.random.default_rng(seed).uniform(-1.0, 1.0, (batch, 5, 3)))
    for camera, own, expected in zip(cameras_from_pinhole(pinhole), points, pinhole.project(points), strict=True):
        corners, _ = camera.project(own, HEIGHT, WIDTH)
        bound = 1024 * EPSILON * float(expected.abs().max() + 1.0)
        torch.testing.assert_close(corners[:, :2] / corners[:, 2:] - 0.5, expected, atol=bound, rtol=0.0)


@given(SEEDS, st.integers(1, 3))
@FEWER_EXAMPLES
def test_kornias_cameras_survive_the_round_trip(seed: int, batch: int) -> None:
    pinhole = random_pinhole(seed, batch)
    again = pinhole_from_cameras(cameras_from_pinhole(pinhole), HEIGHT, WIDTH)
    for name in ("intrinsics", "extrinsics", "height", "width"):
        expected = getattr(pinhole, name)
        bound = 256 * EPSILON * float(expected.abs().max())
        torch.testing.assert_close(getattr(again, name), expected, atol=bound, rtol=0.0)


def test_gradients_reach_the_matrices_of_a_pinhole_camera() -> None:
    pinhole = random_pinhole(0, 1)
    intrinsics, extrinsics = pinhole.intrinsics.requires_grad_(), pinhole.extrinsics.requires_grad_()
    (camera,) = cameras_from_pinhole(PinholeCamera(intrinsics, extrinsics, pinhole.height, pinhole.width))
    corners, _ = camera.project(torch.ones(1, 3, dtype=torch.float64), HEIGHT, WIDTH)
    slopes = torch.autograd.grad(corners.sum(), [intrinsics, extrinsics])
    assert all(bool(slope.any()) for slope in slopes)


def test_orthographic_cameras_are_no_pinhole_cameras() -> None:
    for cameras in ([Camera((0.0, 0.0, 5.0), extent=2.0)], []):
        with pytest.raises(ParameterError, match="perspective"):
            pinhole_from_cameras(cameras, HEIGHT, WIDTH)


@given(SEEDS)
@FEWER_EXAMPLES
def test_the_handles_of_a_mesh_move_its_vertices_as_the_pose_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = Se3(Quaternion(torch.from_numpy(rng.normal(size=4))), torch.from_numpy(rng.normal(size=3)))
    vertices = torch.from_numpy(rng.normal(size=(6, 3)))
    translation, rotation = values_from_pose(pose)
    handles: list[tuple[PoseParameter, Tensor]] = [
        (Rotate("mesh", pivot=(0, 0, 0)), rotation),
        (Translate("mesh"), translation),
    ]
    expected = vertices @ pose.so3.matrix().T + pose.t
    bound = 64 * EPSILON * float(expected.detach().abs().max())
    moved = apply_handles(vertices, handles, torch.ones(3, dtype=torch.float64))
    torch.testing.assert_close(moved, expected, atol=bound, rtol=0.0)
    again = pose_from_values(translation, rotation)
    torch.testing.assert_close(again.matrix(), pose.matrix(), atol=64 * EPSILON * (1.0 + bound), rtol=1e-14)


def test_a_batch_of_poses_is_refused() -> None:
    with pytest.raises(ParameterError, match="one pose"):
        values_from_pose(Se3.identity(2))

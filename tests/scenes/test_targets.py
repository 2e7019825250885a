"""Targets: encoded or linear, with opacity, with weights, and of any range."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from loi_core import LOIObjective, read_target
from loi_core.cli import main
from loi_core.errors import ImageFileError, OptionError, SceneError
from loi_core.io.images import read_image, write_png
from loi_core.pixels.display import Display
from loi_core.pixels.encoding import decode_srgb, encode_srgb
from loi_core.pixels.psnr import psnr
from loi_core.scenes.experiment import run_scene
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED, Host
from tests.one_disk import DISK, START, lay_out_disk

IMAGE: Host = np.round(np.random.default_rng(0).uniform(size=(12, 16, 3)) * 255.0) / 255.0
OPACITY: Host = np.round(np.random.default_rng(1).uniform(size=(12, 16)) * 255.0) / 255.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_png(tmp_path / "photo.png", IMAGE)
    whole = np.rint(np.concatenate([IMAGE, OPACITY[..., None]], axis=-1) * 255.0).astype(np.uint8)
    Image.fromarray(whole).save(tmp_path / "cut.png")
    np.save(tmp_path / "floats.npy", IMAGE)
    np.save(tmp_path / "bytes.npy", np.rint(IMAGE * 255.0).astype(np.uint8))
    write_exr(tmp_path / "light.exr", np.concatenate([IMAGE * OPACITY[..., None], OPACITY[..., None]], axis=-1))
    return tmp_path


def write_exr(path: Path, image: Host) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGBA"[: image.shape[2]]: image.astype(np.float32)}).write(str(path))


@given(st.floats(-0.5, 4.0))
def test_decoding_inverts_encoding(value: float) -> None:
    assert float(decode_srgb(encode_srgb(np.asarray(value)))) == pytest.approx(value, abs=1e-12)
    assert float(encode_srgb(decode_srgb(np.asarray(value)))) == pytest.approx(value, abs=1e-7)  # the knee is rounded


def test_srgb_one_half_is_linear_one_fifth() -> None:
    assert float(decode_srgb(np.asarray(0.5))) == pytest.approx(0.21404, abs=1e-5)  # IEC 61966-2-1


@pytest.mark.parametrize(
    ("name", "to", "encoding", "expected"),
    [
        ("photo.png", None, None, IMAGE),
        ("photo.png", "linear", None, decode_srgb(IMAGE)),
        ("photo.png", "linear", "linear", IMAGE),
        ("photo.png", "sRGB", None, IMAGE),
        ("bytes.npy", "linear", None, decode_srgb(IMAGE)),
        ("floats.npy", "linear", None, IMAGE),
        ("floats.npy", "srgb", None, encode_srgb(IMAGE)),
        ("floats.npy", "linear", "sRGB", decode_srgb(IMAGE)),
    ],
)
def test_a_target_is_converted_to_the_encoding_of_the_renderer(
    name: str, to: Any, encoding: Any, expected: Host, folder: Path
) -> None:
    target = read_target(folder / name, to=to, encoding=encoding)
    np.testing.assert_allclose(target.image, expected, atol=1e-12)
    assert bool(target.notes) == (expected is not IMAGE)
    assert target.weights is None


@pytest.mark.parametrize(("name", "error"), [("cut.png", 1e-12), ("light.exr", 1e-6)])
def test_opacity_is_composited_or_becomes_weights(name: str, error: float, folder: Path) -> None:
    alpha = OPACITY[..., None]
    over = read_target(folder / name, alpha=(0.2, 0.4, 0.6))
    np.testing.assert_allclose(over.image, alpha * IMAGE + (1 - alpha) * np.array([0.2, 0.4, 0.6]), atol=error)
    assert "composited over [0.2, 0.4, 0.6]" in over.notes[0]
    black = read_target(folder / name)
    np.testing.assert_allclose(black.image, alpha * IMAGE, atol=error)
    assert "composited over black" in black.notes[0]
    mask = read_target(folder / name, alpha="mask")
    assert mask.weights is not None
    np.testing.assert_allclose(mask.weights, OPACITY, atol=error)
    visible = OPACITY > 0.0
    np.testing.assert_allclose(mask.image[visible], IMAGE[visible], atol=300 * error)
    assert read_target(folder / name, alpha="ignore").weights is None


def test_premultiplied_light_at_opacity_zero_is_kept(folder: Path) -> None:
    glow = np.concatenate([np.full((12, 16, 3), 0.5), np.zeros((12, 16, 1))], axis=-1)
    write_exr(folder / "glow.exr", glow)
    np.testing.assert_allclose(read_target(folder / "glow.exr", to="linear").image, 0.5)
    np.testing.assert_allclose(read_target(folder / "glow.exr", alpha=np.ones(3)).image, 1.5)
    glow[..., 3] = 0.5
    write_exr(folder / "glow.exr", glow)
    np.testing.assert_allclose(read_target(folder / "glow.exr", alpha="ignore").image, 0.5)


def test_a_mask_without_opacity_is_reported(folder: Path) -> None:
    target = read_target(folder / "photo.png", alpha="mask")
    assert target.weights is None
    assert "has no opacity" in target.notes[0]


def test_weights_can_be_booleans_or_opacity(folder: Path) -> None:
    np.save(folder / "mask.npy", OPACITY > 0.5)
    mask = read_target(folder / "photo.png", weights=folder / "mask.npy").weights
    assert mask is not None
    np.testing.assert_array_equal(mask, OPACITY > 0.5)
    white = np.full((12, 16, 4), 255, np.uint8)
    white[:6, :, 3] = 0
    Image.fromarray(white).save(folder / "holes.png")
    holes = read_target(folder / "photo.png", weights=folder / "holes.png").weights
    assert holes is not None
    np.testing.assert_array_equal(holes, white[..., 3] / 255.0)


def test_compositing_is_linear_for_linear_targets(folder: Path) -> None:
    target = read_target(folder / "cut.png", to="linear", alpha=(1.0, 1.0, 1.0))
    alpha = OPACITY[..., None]
    np.testing.assert_allclose(target.image, alpha * decode_srgb(IMAGE) + 1 - alpha, atol=1e-12)


def test_weights_of_a_file_multiply_the_opacity(folder: Path) -> None:
    np.save(folder / "weights.npy", 3.0 * IMAGE[..., 0])
    from_file = read_target(folder / "photo.png", weights=folder / "weights.npy")
    product = read_target(folder / "cut.png", alpha="mask", weights=folder / "weights.npy")
    assert from_file.weights is not None
    assert product.weights is not None
    np.testing.assert_allclose(from_file.weights, 3.0 * IMAGE[..., 0])
    np.testing.assert_allclose(product.weights, 3.0 * IMAGE[..., 0] * OPACITY)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"to": "gamma"}, OptionError, "`encoding` must be 'linear' or 'sRGB'"),
        ({"encoding": 3}, OptionError, "`encoding` must be 'linear' or 'sRGB'"),
        ({"alpha": "cut"}, OptionError, "`alpha` must be 'mask', 'ignore', or the three numbers"),
        ({"alpha": (1, 2)}, OptionError, "`alpha` must be"),
        ({"weights": "small.png"}, ImageFileError, "weights must be of the target's size, 12 x 16"),
        ({"weights": "minus.npy"}, ImageFileError, "weights must be finite and not negative"),
        ({"weights": "black.png"}, ImageFileError, "every pixel has weight 0"),
    ],
)
def test_invalid_options_of_a_target_are_refused(
    options: dict[str, Any], error: type[Exception], message: str, folder: Path
) -> None:
    write_png(folder / "small.png", np.ones((4, 4, 3)))
    write_png(folder / "black.png", np.zeros((12, 16, 3)))
    np.save(folder / "minus.npy", np.full((12, 16), -1.0))
    if "weights" in options:
        options = {"weights": folder / options["weights"]}
    with pytest.raises(error, match=re.escape(message)):
        read_target(folder / "photo.png", **options)


SCENE = f"""\
target = "target.png"
{DISK}{START}[fit]
steps = 60
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return lay_out_disk(tmp_path, SCENE)


def test_pixels_with_weight_zero_do_not_affect_a_scene(scene: Path) -> None:
    mask = np.ones((16, 16, 3))
    mask[:4] = 0.0
    modified = read_image(scene.parent / "target.png")
    modified[:4] = 0.5
    write_png(scene.parent / "target.png", modified)
    write_png(scene.parent / "mask.png", mask)
    scene.write_text('weights = "mask.png"\n' + SCENE + '[objective]\ncompare = ["pixel_l2", "ms_ssim"]\n')
    loaded = load_scene(scene)
    assert loaded.first_view.target.weights is not None
    for objective in loaded.objectives.values():
        np.testing.assert_array_equal(objective.weights, mask[..., 0])  # type: ignore[attr-defined]
    trial = run_scene(loaded)[0]
    assert trial.result is not None
    np.testing.assert_allclose(trial.result.best_params["positions"], [[10, 6]], atol=0.05)
    assert trial.psnr[trial.result.best_step - 1] > 30.0  # over pixels with weight


def test_conversions_of_a_target_are_reported(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene.write_text('encoding = "sRGB"\nalpha = [1, 1, 1]\n' + SCENE)
    assert main(["fit", str(scene)]) in FINISHED
    printed = capsys.readouterr().err
    assert "loi: target.png is taken as sRGB, and decoded to linear light" in printed
    result = json.loads((scene.parent / "scene-result" / "result.json").read_text())
    assert any("decoded to linear light" in note for note in result["notes"])
    assert "decoded to linear light" in (scene.parent / "scene-result" / "report.html").read_text()
    np.testing.assert_allclose(load_scene(scene).target, decode_srgb(read_image(scene.parent / "target.png")))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('encoding = "gamma"', "`encoding` must be 'linear' or 'sRGB', got 'gamma'"),
        ("alpha = 3", "`alpha` must be 'mask', 'ignore'"),
        ("weights = 3", "`weights` must be a text"),
    ],
)
def test_wrong_keys_of_a_target_are_named(line: str, message: str, scene: Path) -> None:
    scene.write_text(line + "\n" + SCENE)
    with pytest.raises(SceneError, match=re.escape(message)):
        load_scene(scene)


def test_a_report_shows_light_of_any_range() -> None:
    light = np.random.default_rng(0).exponential(size=(32, 32, 3)) * 20.0
    display = Display.of(light, "linear")
    shown = display.show(light)
    assert 0.1 < float(np.median(shown)) < 0.9
    assert float(np.mean(shown == 1.0)) < 0.02
    assert "exposed by" in display.note
    assert "encoded as sRGB" in display.note


def test_a_report_shows_a_picture_unchanged() -> None:
    assert Display.of(IMAGE, None).note == ""
    np.testing.assert_array_equal(Display.of(IMAGE, "sRGB").show(IMAGE), IMAGE)
    np.testing.assert_allclose(Display.of(IMAGE, "linear").show(IMAGE), encode_srgb(IMAGE))


def test_psnr_counts_pixels_by_their_weights() -> None:
    image = IMAGE.copy()
    image[:6] = 0.0
    weights = np.ones((12, 16))
    weights[:6] = 0.0
    assert psnr(image, IMAGE, weights) == np.inf
    assert psnr(np.where(weights[..., None] > 0, IMAGE, np.nan), IMAGE, weights) == np.inf
    assert psnr(image, IMAGE) < 20.0
    assert LOIObjective(IMAGE, weights=weights).value(image) == 0.0


def test_a_background_of_another_size_than_the_target_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, size in (("photo", (24, 32)), ("background", (30, 40)), ("picture", (8, 8))):
        write_png(tmp_path / f"{name}.png", np.full((*size, 3), 0.5))
    images = '[renderer]\nname = "warp"\n[renderer.images]\npicture = "picture.png"\nbackground = "background.png"\n'
    (tmp_path / "scene.toml").write_text(f'target = "photo.png"\n{images}[optimise.translation]\n')
    assert main(["fit", str(tmp_path / "scene.toml")]) == 2
    message = (
        "makes images of shape (30, 40, 3), the target has (24, 32, 3); its images are as large as its `background`"
    )
    assert message in capsys.readouterr().err

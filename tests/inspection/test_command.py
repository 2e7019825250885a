"""``loi inspect``: a self-contained page, numbers as text and JSON, and one line for every wrong call."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from loi_core import LOIObjective, ScaleSpace
from loi_core.cli import main
from loi_core.io.images import read_image, write_png
from tests.inspection.pictures import disks, textures


def inspect(folder: Path, *arguments: str) -> int:
    return main(["inspect", *arguments, "--output", str(folder / "page.html")])


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    for name, image in zip(("image.png", "reference.png"), disks(), strict=True):
        write_png(tmp_path / name, image)
    return str(tmp_path / "image.png"), str(tmp_path / "reference.png")


def test_the_numbers_agree_with_the_loss(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect(tmp_path, *files, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    image, reference = map(read_image, files)
    expected = LOIObjective(reference).terms(image)
    assert printed["value"] == pytest.approx(sum(float(term) for term in expected.values()))
    for scale in printed["scales"]:
        key = scale["alpha"], scale["beta"], scale["sigma"]
        assert scale["value"] == pytest.approx(float(expected[key]))
    assert printed["page_bytes"] == (tmp_path / "page.html").stat().st_size < 1e6
    assert printed["why"] == ScaleSpace.for_image(48, 64).describe(48, 64).splitlines()


def test_the_summary_has_a_row_and_a_reason_for_every_scale(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect(tmp_path, files[0]) == 0
    summary = capsys.readouterr().out
    assert summary.startswith("image.png, shifted 1 px to the right, compared with image.png: 64 x 48 pixels, loss 0.0")
    for alpha in ScaleSpace.for_image(48, 64).alpha:
        assert len(re.findall(rf"^\|[^|]+\|[^|]+\| {alpha:g} +\|", summary, re.MULTILINE)) == 1
    assert ScaleSpace.for_image(48, 64).describe(48, 64) in summary
    assert re.search(r"^page: .*page\.html \(0\.\d MB\)$", summary, re.MULTILINE)


def test_the_preset_and_the_bounds_set_the_scales(tmp_path: Path) -> None:
    np.save(tmp_path / "bright.npy", 3.0 * textures(12, 14)[0])
    assert inspect(tmp_path, str(tmp_path / "bright.npy"), "--preset", "path", "--bounds", "0", "3") == 0
    page = unescape((tmp_path / "page.html").read_text())
    assert "ScaleSpace.paper('path')" in page
    assert "bounds 0 to 3" in page
    assert "lies beyond the scales" not in page


@pytest.mark.parametrize("suffix", [".jpg", ".exr"])
def test_jpeg_and_exr_files_are_read(tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    image = textures(12, 14)[0].astype(np.float32)
    path = tmp_path / f"image{suffix}"
    if suffix == ".jpg":
        Image.fromarray(np.uint8(255 * image)).save(path)
    else:
        OpenEXR.File({}, {"RGB": image}).write(str(path))
    assert inspect(tmp_path, str(path), "--json") == 0
    assert json.loads(capsys.readouterr().out)["reference"] == path.name


def test_values_beyond_the_bounds_and_opacity_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "bright.npy", np.concatenate([np.full((9, 9, 3), 4.0), np.full((9, 9, 1), 0.5)], axis=-1))
    assert inspect(tmp_path, str(tmp_path / "bright.npy")) == 0
    notes = capsys.readouterr().err.splitlines()
    assert notes[0] == "loi: bright.npy is composited over black by its opacity"
    assert "lies beyond the scales' `bounds` (0, 1)" in notes[1]
    page = unescape((tmp_path / "page.html").read_text())
    assert all(line.removeprefix("loi: ") in page for line in notes)


def test_the_policy_of_an_inspection_allows_only_its_own_script_and_style(
    tmp_path: Path, files: tuple[str, str]
) -> None:
    assert inspect(tmp_path, *files) == 0
    page = (tmp_path / "page.html").read_text()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy
    rules = dict(rule.split(" ", 1) for rule in policy[1].split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for tag in ("style", "script"):
        (content,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert rules[f"{tag}-src"] == f"'sha256-{digest}'"
    assert " style=" not in page
    assert not re.search(r"""(src|href)=["'](?!data:image/png;base64,|")""", page)


def test_names_of_files_cannot_become_markup(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)>&'\".npy"
    np.save(tmp_path / name, textures(8, 9)[0])
    assert inspect(tmp_path, str(tmp_path / name)) == 0
    page = (tmp_path / "page.html").read_text()
    assert "<img src=x" not in page
    assert "&lt;img src=x" in page


def test_an_earlier_page_is_replaced_and_any_other_file_is_kept(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    page.write_text("<p>foreign</p>")
    assert inspect(tmp_path, *files) == 2
    assert capsys.readouterr().err == (
        f"loi: {page} was not written by `loi inspect`; move it away, or give another `--output`\n"
    )
    assert page.read_text() == "<p>foreign</p>"
    page.unlink()
    assert inspect(tmp_path, files[0]) == 0
    first = page.read_text()
    assert inspect(tmp_path, files[1]) == 0
    assert page.read_text() != first


def test_wrong_calls_get_one_line_and_write_nothing(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    broken, small = disks()[0], textures(5, 7)[0]
    broken[1, 2] = np.inf
    np.save(tmp_path / "broken.npy", broken)
    np.save(tmp_path / "small.npy", small)
    page = ["--output", str(tmp_path / "page.html")]
    calls = {
        "`IMAGE` and `REFERENCE` must have the same size, got 64 x 48 and 7 x 5 pixels": [
            *(files[0], str(tmp_path / "small.npy"), *page)
        ],
        "almost 0; fix the image, or replace the values, as numpy.nan_to_num does": [
            str(tmp_path / "broken.npy"),
            *page,
        ],
        "`image` has 3 non-finite values": [str(tmp_path / "broken.npy"), *page],
        "no such image file": [str(tmp_path / "none.png"), *page],
        "images must end in": [str(tmp_path / "image.tiff"), *page],
        "`--output` must end in .html": [files[0], "--output", str(tmp_path / "image.png")],
        "`bounds` must be two finite intensities": [files[0], "--bounds", "1", "0", *page],
        "invalid choice: 'photo'": [files[0], "--preset", "photo", *page],
        "`--output` must lead to a folder": [files[0], "--output", str(tmp_path / "image.png" / "page.html")],
    }
    files_before = sorted(tmp_path.iterdir())
    for words, arguments in calls.items():
        assert main(["inspect", *arguments]) == 2
        message = capsys.readouterr().err
        assert words in message
        assert message.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == files_before

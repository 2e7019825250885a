"""The content of a report, its sources in the result folder, and the private facts that it leaves out."""

from __future__ import annotations

import base64
import csv
import getpass
import hashlib
import io
import json
import os
import re
import socket
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from loi_core.cli import main
from loi_core.io.images import read_image
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK, START, lay_out_disk


def page_of(folder: Path) -> str:
    assert main(["report", str(folder)]) == 0
    return (folder / "report.html").read_text(encoding="utf-8")


def download(page: str, name: str) -> bytes:
    """Return the content of a link to a file inside the page."""
    link = re.search(rf'download="[^"]*{re.escape(name)}" href="data:[\w/]+;base64,([^"]+)"', page)
    assert link is not None
    return base64.b64decode(link[1])


def test_the_scales_of_every_recorded_step_sum_to_the_value_of_the_objective(fitted: Path) -> None:
    rows = list(csv.DictReader(io.StringIO((fitted / "scales.csv").read_text())))
    history = {int(row["step"]): row for row in csv.DictReader(io.StringIO((fitted / "history.csv").read_text()))}
    steps = sorted({int(row["step"]) for row in rows})
    assert steps == sorted(int(path.stem) for path in (fitted / "frames").iterdir())
    assert len(rows) == 2 * len(steps) == 48
    for step in steps:
        total = sum(float(row["value"]) for row in rows if int(row["step"]) == step)
        assert total == pytest.approx(float(history[step]["value"]), rel=1e-12)


def test_the_pictures_of_the_scales_add_up_to_the_negative_gradient(scene: Path, fitted: Path) -> None:
    loaded = load_scene(scene)
    start = read_image(fitted / "initial.png")
    scales = json.loads((fitted / "result.json").read_text())["scales"]
    assert [scale["alpha"] for scale in scales] == [2.0, 6.0]
    total = np.zeros_like(start)
    for scale in scales:
        file = f"start-sigma-1-alpha-{scale['alpha']:g}-beta-0.125.png"
        shown = read_image(fitted / "gradients" / file) - 0.5
        total += shown * scale["gradient_norm"]["start"] / np.linalg.norm(shown)
    gradient: Any = loaded.objectives["loi"].value_and_grad(start)[1]
    cosine = -np.sum(total * gradient) / np.linalg.norm(total) / np.linalg.norm(gradient)
    assert cosine > 0.97  # pictures have 8 bits, and clip their largest values


def test_a_page_shows_how_its_fit_was_made_but_not_on_whose_machine(fitted: Path, scene: Path) -> None:
    page = page_of(fitted)
    for text in ("loi fit scene.toml --steps=60", "<dt>seed</dt><dd>0</dd>", "exact: value and gradient", "CPython"):
        assert text in page
    assert "numpy arrays of float64, on cpu" in page
    plain = unescape(page) + download(page, "result.json").decode()
    for private in (str(scene.parent), str(Path.home()) + os.sep, socket.gethostname() + " "):
        assert private not in plain
    if getpass.getuser() not in ("root", "user"):
        assert getpass.getuser() not in plain


def test_the_policy_of_a_page_allows_only_its_own_style_and_script(fitted: Path) -> None:
    page = page_of(fitted)
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; img-src data:; style-src 'sha256-")
    assert "unsafe" not in policy[1]
    for tag in ("style", "script"):
        (inner,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(inner.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy[1]
    assert not re.search(r'\sstyle="|\son\w+="|src="(?!data:)|href="(?!data:|#)', page)


def test_a_page_contains_its_tables_and_an_animation(fitted: Path) -> None:
    page = page_of(fitted)
    for name in ("history.csv", "scales.csv", "parameters.json"):
        assert download(page, name) == (fitted / name).read_bytes()
    assert json.loads(download(page, "result.json"))["title"] == "One disk"
    with Image.open(io.BytesIO(download(page, "fit.webp"))) as animated:
        frames = len(list((fitted / "frames").iterdir()))
        assert (animated.format, getattr(animated, "n_frames", 1)) == ("WEBP", frames)
        assert animated.size == (384, 384)  # 16 pixels enlarged


def test_a_page_leaves_out_the_sections_whose_files_are_missing(copied: Path) -> None:
    (copied / "scales.csv").unlink()
    for picture in (copied / "gradients").iterdir():
        picture.unlink()
    result = json.loads((copied / "result.json").read_text())
    for key in ("scales", "command", "seed", "truth", "accuracy", "environment"):
        result.pop(key)
    (copied / "result.json").write_text(json.dumps(result))
    page = page_of(copied)
    assert page.count("<svg") == 3
    assert "Share of each scale" not in page
    for history in copied.rglob("history.csv"):
        history.unlink()
    page = page_of(copied)
    assert "<svg" not in page
    assert "<h2>Numbers</h2>" in page


@pytest.mark.parametrize(
    "content",
    [
        *("", "\0", "step,value\n" + "1,2\n" * 3, 'step,"' * 9),
        "step,value,psnr\n1e308,1e308,nan\n-1e308,-1e308,inf\n",
        "step,value,psnr,a[0],a[1],step\n1,2\n",
        "step,value,psnr,a\n0,1,2,5e-324\n1,5e-324,-5e-324,1e-320\nx,y,z,w\n",
    ],
)
def test_a_damaged_table_does_not_prevent_the_page(copied: Path, content: str) -> None:
    for name in ("history.csv", "scales.csv"):
        (copied / name).write_text(content.replace("psnr", "psnr" if name == "history.csv" else "sigma,alpha,beta"))
    assert "<h2>Numbers</h2>" in page_of(copied)


def test_several_folders_make_one_page(fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(fitted), str(fitted)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert page.count('<section class="run"') == 2
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert main(["report", str(fitted), str(fitted)]) == 0  # it may be rewritten


def test_the_page_of_several_folders_does_not_turn_its_folder_into_a_result(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(fitted), str(fitted)]) == 0
    assert main(["report", "."]) == 2
    assert capsys.readouterr().err == "loi: .: no result.json there; give a folder that `loi fit` has written\n"


def test_a_page_of_several_folders_replaces_no_other_file(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "foreign.html"
    foreign.write_text("foreign")
    for path in (foreign, tmp_path):
        assert main(["report", str(fitted), str(fitted), "--output", str(path)]) == 2
        assert "was not written by `loi`" in capsys.readouterr().err
    assert foreign.read_text() == "foreign"
    assert main(["report", str(fitted), "--output", str(foreign)]) == 2
    assert "`--output` goes with several folders" in capsys.readouterr().err
    assert main(["report", str(fitted), str(tmp_path), "--output", str(tmp_path / "x.html")]) == 2
    assert not (tmp_path / "x.html").exists()


def test_the_scales_of_an_earlier_objective_are_removed(tmp_path: Path) -> None:
    text = f'target = "target.png"\noutput = "result"\n\n{DISK}\n{START}\n[fit]\nsteps = 2\n'
    path = lay_out_disk(tmp_path, text)
    assert main(["fit", str(path)]) in FINISHED
    assert (tmp_path / "result" / "scales.csv").exists()
    assert list((tmp_path / "result" / "gradients").iterdir())
    path.write_text(f'{text}\n[objective]\nname = "pixel_l2"\n')
    assert main(["fit", str(path)]) in FINISHED
    assert not (tmp_path / "result" / "scales.csv").exists()
    assert not list((tmp_path / "result" / "gradients").iterdir())
    assert "Gradient of each scale" not in (tmp_path / "result" / "report.html").read_text()

"""What a report says, where it has it from, and what it does not tell."""

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
from loi_core.report.charts import Chart, Line, draw
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK, START, lay_out_disk


def page_of(folder: Path) -> str:
    assert main(["report", str(folder)]) == 0
    return (folder / "report.html").read_text(encoding="utf-8")


def handed_out(page: str, name: str) -> bytes:
    found = re.search(rf'download="[^"]*{re.escape(name)}" href="data:[\w/]+;base64,([^"]+)"', page)
    assert found is not None
    return base64.b64decode(found[1])


def test_the_scales_of_every_recorded_step_sum_to_the_value_of_the_objective(fitted: Path) -> None:
    rows = list(csv.DictReader(io.StringIO((fitted / "scales.csv").read_text())))
    history = {int(row["step"]): row for row in csv.DictReader(io.StringIO((fitted / "history.csv").read_text()))}
    steps = sorted({int(row["step"]) for row in rows})
    assert steps == sorted(int(path.stem) for path in (fitted / "frames").iterdir())
    assert len(rows) == 2 * len(steps) == 48
    for step in steps:
        total = sum(float(row["value"]) for row in rows if int(row["step"]) == step)
        assert total == pytest.approx(float(history[step]["value"]), rel=1e-12)


def test_the_pull_of_a_scale_is_the_gradient_against_its_sign(scene: Path, fitted: Path) -> None:
    loaded = load_scene(scene)
    start = read_image(fitted / "initial.png")
    told = json.loads((fitted / "result.json").read_text())["scales"]
    assert [one["alpha"] for one in told] == [2.0, 6.0]
    total = np.zeros_like(start)
    for one in told:
        file = f"start-sigma-1-alpha-{one['alpha']:g}-beta-0.125.png"
        shown = read_image(fitted / "gradients" / file) - 0.5
        total += shown * one["pull"]["start"] / np.linalg.norm(shown)
    gradient: Any = loaded.objectives["loi"].value_and_grad(start)[1]
    cosine = -np.sum(total * gradient) / np.linalg.norm(total) / np.linalg.norm(gradient)
    assert cosine > 0.97  # of 8 bits, and clipped at the brightest


def test_a_page_says_how_it_was_made_and_not_on_whose_machine(fitted: Path, scene: Path) -> None:
    page = page_of(fitted)
    for said in ("loi fit scene.toml --steps=60", "<dt>seed</dt><dd>0</dd>", "exact: value and gradient", "CPython"):
        assert said in page
    assert "numpy arrays of float64, on cpu" in page
    plain = unescape(page) + handed_out(page, "result.json").decode()
    for private in (str(scene.parent), str(Path.home()) + os.sep, socket.gethostname() + " "):
        assert private not in plain
    if getpass.getuser() not in ("root", "user"):
        assert getpass.getuser() not in plain


def test_a_page_lets_nothing_be_loaded_and_no_script_run_but_its_own(fitted: Path) -> None:
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


def test_a_page_carries_its_tables_and_an_animation(fitted: Path) -> None:
    page = page_of(fitted)
    for name in ("history.csv", "scales.csv", "parameters.json"):
        assert handed_out(page, name) == (fitted / name).read_bytes()
    assert json.loads(handed_out(page, "result.json"))["title"] == "One disk"
    with Image.open(io.BytesIO(handed_out(page, "fit.webp"))) as moving:
        frames = len(list((fitted / "frames").iterdir()))
        assert (moving.format, getattr(moving, "n_frames", 1)) == ("WEBP", frames)
        assert moving.size == (384, 384)  # 16 pixels enlarged


def test_a_folder_of_before_still_makes_a_page(copied: Path) -> None:
    (copied / "scales.csv").unlink()
    for picture in (copied / "gradients").iterdir():
        picture.unlink()
    told = json.loads((copied / "result.json").read_text())
    for key in ("scales", "command", "seed", "truth", "accuracy", "environment"):
        told.pop(key)
    (copied / "result.json").write_text(json.dumps(told))
    page = page_of(copied)
    assert page.count("<svg") == 3
    assert "Share of each scale" not in page
    for history in copied.rglob("history.csv"):
        history.unlink()
    page = page_of(copied)
    assert "<svg" not in page
    assert 'alt="objective and PSNR by step"' in page


@pytest.mark.parametrize(
    "content",
    [
        *("", "\0", "step,value\n" + "1,2\n" * 3, 'step,"' * 9),
        "step,value,psnr\n1e308,1e308,nan\n-1e308,-1e308,inf\n",
        "step,value,psnr,a[0],a[1],step\n1,2\n",
        "step,value,psnr,a\n0,1,2,5e-324\n1,5e-324,-5e-324,1e-320\nx,y,z,w\n",
    ],
)
def test_a_table_that_somebody_has_damaged_stops_no_page(copied: Path, content: str) -> None:
    for name in ("history.csv", "scales.csv"):
        (copied / name).write_text(content.replace("psnr", "psnr" if name == "history.csv" else "sigma,alpha,beta"))
    assert "<h2>Numbers</h2>" in page_of(copied)


def test_charts_of_any_numbers_stay_within_their_frame() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        size = int(rng.integers(1, 5))
        values = [float(one) for one in rng.choice([0.0, 1.0, -1.0, 1e308, 1e-300, 5e-324, np.nan, np.inf, 7.0], size)]
        steps = [float(one) for one in rng.choice([0.0, 1.0, 2.0, 1e17, -4.0, np.nan], size)]
        for log in (False, True):
            drawn = draw(Chart("a", [Line("b", steps, values, 0, float(rng.choice([1.0, np.nan, 1e305])))], log=log))
            for points in re.findall(r'points="([^"]*)"', drawn):
                for point in points.split():
                    x, y = map(float, point.split(","))
                    assert 50.0 <= x <= 420.0
                    assert 0.0 <= y <= 250.0


def test_several_folders_make_one_page(fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(fitted), str(fitted)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert page.count('<section class="run"') == 2
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert main(["report", str(fitted), str(fitted)]) == 0  # it may be made anew


def test_the_page_of_several_folders_makes_no_result_of_where_it_lies(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(fitted), str(fitted)]) == 0
    assert main(["report", "."]) == 2
    assert capsys.readouterr().err == "loi: .: no result.json there; give a folder that `loi fit` has written\n"


def test_a_page_of_several_replaces_nothing_of_somebody(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.html"
    mine.write_text("mine")
    for place in (mine, tmp_path):
        assert main(["report", str(fitted), str(fitted), "--output", str(place)]) == 2
        assert "was not written by `loi`" in capsys.readouterr().err
    assert mine.read_text() == "mine"
    assert main(["report", str(fitted), "--output", str(mine)]) == 2
    assert "`--output` goes with several folders" in capsys.readouterr().err
    assert main(["report", str(fitted), str(tmp_path), "--output", str(tmp_path / "x.html")]) == 2
    assert not (tmp_path / "x.html").exists()


def test_what_an_earlier_objective_left_of_its_scales_is_removed(tmp_path: Path) -> None:
    text = f'target = "target.png"\noutput = "result"\n\n{DISK}\n{START}\n[fit]\nsteps = 2\n'
    path = lay_out_disk(tmp_path, text)
    assert main(["fit", str(path)]) in FINISHED
    assert (tmp_path / "result" / "scales.csv").exists()
    assert list((tmp_path / "result" / "gradients").iterdir())
    path.write_text(f'{text}\n[objective]\nname = "pixel_l2"\n')
    assert main(["fit", str(path)]) in FINISHED
    assert not (tmp_path / "result" / "scales.csv").exists()
    assert not list((tmp_path / "result" / "gradients").iterdir())
    assert "What each scale pulls at" not in (tmp_path / "result" / "report.html").read_text()

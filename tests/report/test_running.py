"""``loi fit --watch`` lets the page of the report follow the fit while it runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.fitting.history import FitStep
from loi_core.io.result_folder import ResultFolder
from loi_core.report import RunningPage
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK, START, lay_out_disk

SCENE = f"""\
title = "<b>One</b> disk"
target = "target.png"
output = "result"

{DISK}
{START}
[fit]
steps = 3
"""
IMAGE = np.full((16, 16, 3), 0.5)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return lay_out_disk(tmp_path, SCENE)


def test_the_running_page_shows_step_image_target_and_curves_and_reloads_itself(scene: Path) -> None:
    loaded = load_scene(scene)
    announced: list[Path] = []
    page = RunningPage(loaded, ResultFolder(loaded.output), announced.append)
    page("loi", FitStep(0, 0.5, 1.0, 1.0, 0.1), 20.0, lambda: IMAGE)
    assert announced == [loaded.output / "report.html"]
    html = announced[0].read_text()
    assert "&lt;b&gt;One&lt;/b&gt; disk" in html
    assert "step 1 of 3, PSNR 20 dB, objective 0.5" in html
    assert html.count("data:image/png;base64,") == 2
    assert html.count('<figure class="chart panel">') == 2
    assert "<main data-running>" in html
    assert "location.reload()" in html
    assert "connect-src" not in html


def test_the_running_page_takes_at_most_a_small_part_of_the_time(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = load_scene(scene)
    clock = [0.0]
    written: list[int] = []
    monkeypatch.setattr("loi_core.report.running.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("loi_core.report.running.write_text", lambda *_: clock.__setitem__(0, clock[0] + 2.0))
    page = RunningPage(loaded, ResultFolder(loaded.output), lambda _: None)
    for step in range(1000):
        began = clock[0]
        page("loi", FitStep(step, float("nan"), 1.0, 1.0, 0.1), float("inf"), lambda: IMAGE)
        written += [step] if clock[0] > began else []
        clock[0] += 0.1
    assert len(written) == 3
    assert 2.0 * len(written) / clock[0] < 0.06


def test_a_watched_fit_names_its_page_and_ends_with_the_report(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(scene), "--watch"]) in FINISHED
    page = scene.parent / "result" / "report.html"
    message = re.search(r"^loi: follow the fit at (\S+)$", capsys.readouterr().err, re.MULTILINE)
    assert message is not None
    assert message[1] == page.as_uri()
    html = page.read_text()
    assert "<main data-running>" not in html
    assert "<h2>Numbers</h2>" in html


def test_a_fit_that_is_not_watched_writes_its_page_only_at_the_end(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("loi_core.cli.fit.write_page", lambda folder: folder / "report.html")
    assert main(["fit", str(scene)]) in FINISHED
    assert not (scene.parent / "result" / "report.html").exists()
    assert "follow the fit" not in capsys.readouterr().err

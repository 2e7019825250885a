"""Scene files may use a planned renderer: its plan is explained, used, and shown in the report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.io.images import write_png
from loi_core.pixels.encoding import encode_srgb
from loi_mitsuba import MitsubaRenderer, Translate
from tests.helpers import FINISHED
from tests.mitsuba.test_scene_file import GOAL, SCENE, XML


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.xml").write_text(XML)
    (tmp_path / "scene.toml").write_text(SCENE.replace('"mitsuba"', '"mitsuba-planned"'))
    renderer = MitsubaRenderer(tmp_path / "scene.xml", {"place": Translate("ball")}, spp=256)
    write_png(tmp_path / "target.png", encode_srgb(renderer.render({"place": np.array(GOAL)})))
    return tmp_path


def test_a_plan_is_explained_without_a_fit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(folder / "scene.toml"), "--explain"]) in FINISHED
    printed = capsys.readouterr().out
    assert "| primary visibility       | on " in printed
    assert "the scene is one convex shape" in printed
    assert "Settings: integrator direct_projective" in printed
    assert not (folder / "scene-result").exists()
    assert main(["fit", str(folder / "scene.toml"), "--explain", "--json"]) in FINISHED
    assert json.loads(capsys.readouterr().out)["settings"]["sppi"] == 0


def test_a_scene_file_sets_and_explains_the_proxy(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    light = '<emitter type="point"><point name="position" x="0" y="9" z="0"/></emitter></scene>'
    (folder / "scene.xml").write_text(XML.replace("</scene>", light))
    text = (folder / "scene.toml").read_text().replace("spp = 8", "spp = 64")  # with 8 samples the gradient is noise
    (folder / "scene.toml").write_text(f"{text}\n[renderer.proxy]\nlights = 0.05\n")
    assert main(["fit", str(folder / "scene.toml"), "--explain", "--json"]) in FINISHED
    (reason,) = json.loads(capsys.readouterr().out)["substitutions"].values()
    assert "0.05 of its distance from the moving shapes" in reason
    (folder / "scene.toml").write_text(f"{text}\n[renderer.proxy]\nlights = 2\n")
    assert main(["fit", str(folder / "scene.toml"), "--explain"]) == 2
    assert "`proxy`: `lights` must be 0 to 0.5, got 2" in capsys.readouterr().err


def test_a_fit_uses_the_plan_and_its_page_shows_the_effects(folder: Path) -> None:
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    results = folder / "scene-result"
    np.testing.assert_allclose(json.loads((results / "parameters.json").read_text())["place"], GOAL, atol=0.1)
    page = (results / "report.html").read_text()
    for name in ("continuous shading: on", "primary visibility: on"):
        assert f"<figcaption>{name}</figcaption>" in page
    assert "the scene is one convex shape" in page


def test_explaining_a_renderer_without_a_plan_is_an_error(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scene.toml").write_text(SCENE)
    assert main(["fit", str(folder / "scene.toml"), "--explain"]) == 2
    assert "[renderer] does not plan its effects; renderers that do are named *-planned" in capsys.readouterr().err

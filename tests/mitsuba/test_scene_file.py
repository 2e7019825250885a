"""Scene files fit entries and poses of Mitsuba scenes, from any current folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import SceneError
from loi_core.io.images import write_png
from loi_core.pixels.encoding import encode_srgb
from loi_core.scenes.reading import load_scene
from loi_mitsuba import MitsubaRenderer, Rotate, Scale, Translate
from tests.helpers import FINISHED
from tests.strategies import thorough

GOAL = [0.9, -0.5, 0.0]

BALL = Path(__file__).parents[2] / "examples" / "ball"
# The same on fewer pixels, which is quicker.
XML = (BALL / "scene.xml").read_text().replace('value="96"', 'value="32"').replace('value="72"', 'value="24"')
SCENE = (BALL / "scene.toml").read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.xml").write_text(XML)
    (tmp_path / "scene.toml").write_text(SCENE)
    renderer = MitsubaRenderer(tmp_path / "scene.xml", {"place": Translate("ball")}, spp=256)
    write_png(tmp_path / "target.png", encode_srgb(renderer.render({"place": np.array(GOAL)})))
    return tmp_path


def test_a_fit_moves_a_shape_to_its_position_in_the_target(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    # With so few pixels and 8 samples, gradients are half noise, and the result of 40 steps is random.
    (folder / "scene.toml").write_text(SCENE.replace("spp = 8", "spp = 32"))
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    fitted = json.loads((folder / "scene-result" / "parameters.json").read_text())
    # A pixel is 0.24 units of the world there.
    np.testing.assert_allclose(fitted["place"], GOAL, atol=0.1)


@thorough
def test_the_example_of_a_ball_is_fitted_within_a_pixel(tmp_path: Path) -> None:
    assert main(["fit", str(BALL / "scene.toml"), "--output", str(tmp_path / "result")]) in FINISHED
    fitted = json.loads((tmp_path / "result" / "parameters.json").read_text())
    np.testing.assert_allclose(fitted["place"], GOAL, atol=0.08)


def test_tables_are_equivalent_to_handles(folder: Path) -> None:
    targets: dict[str, tuple[dict[str, Any], Any]] = {
        "move": ({"Translate": "ball"}, Translate("ball")),
        "slide": ({"Translate": "ball", "axis": [0, 2, 0]}, Translate("ball", axis=[0, 1, 0])),
        "turn": ({"Rotate": "ball", "axis": [0, 0, 1]}, Rotate("ball", axis=[0, 0, 1])),
        "swing": ({"Rotate": "ball", "axis": [1, 0, 0], "pivot": [0, 1, 0]}, Rotate("ball", [1, 0, 0], [0, 1, 0])),
        "size": ({"Scale": "ball", "pivot": [1, 0, 0]}, Scale("ball", pivot=[1, 0, 0])),
    }
    tables = MitsubaRenderer(folder / "scene.xml", {name: table for name, (table, _) in targets.items()})
    classes = MitsubaRenderer(folder / "scene.xml", {name: handle for name, (_, handle) in targets.items()})
    assert tables.targets == classes.targets


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("{ Translate =", "{ translate =", "a pose parameter has one key of Translate, Rotate, Scale, got translate"),
        ("{ Translate =", "{ Rotate =", "Rotate needs `axis`"),
        (
            '"ball" }',
            '"ball", Scale = "ball" }',
            "a pose parameter has one key of Translate, Rotate, Scale, got Translate, Scale",
        ),
        ('"ball" }', '"ball", axes = [1, 0, 0] }', "unknown key `axes`; Translate takes axis"),
        ('"ball" }', '"ball", axis = [1, 0] }', "`axis` must be three finite numbers, got [1, 0]"),
        ('"ball" }', '"ball", axis = [1, 0, true] }', "`axis` must be three finite numbers, got [1, 0, True]"),
    ],
)
def test_a_wrong_table_is_an_error_that_names_the_parameter(folder: Path, old: str, new: str, says: str) -> None:
    (folder / "scene.toml").write_text(SCENE.replace(old, new))
    with pytest.raises(SceneError) as caught:
        load_scene(folder / "scene.toml")
    assert f"[renderer] `parameters['place']`: {says}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_scene_is_an_error_that_names_the_file(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("scene.xml", "nothing.xml"))
    with pytest.raises(SceneError, match=r"\[renderer\] `scene` cannot be loaded: .*nothing\.xml"):
        load_scene(folder / "scene.toml")


def test_the_scene_file_in_the_docs_can_be_loaded(folder: Path) -> None:
    guide = (Path(__file__).parents[2] / "docs" / "guide" / "mitsuba.md").read_text()
    text = guide.split("```toml\n")[1].split("```")[0].replace("photo.exr", "target.png")
    (folder / "scene.xml").write_text(
        XML.replace(
            "<emitter",
            '<shape type="cube" id="box"><boolean name="face_normals" value="true"/></shape>'
            '<shape type="rectangle" id="floor"><bsdf type="diffuse"/></shape><emitter',
        )
    )
    (folder / "guide.toml").write_text(text)
    scene = load_scene(folder / "guide.toml")
    assert list(scene.renderer.parameters()) == ["place", "turn", "colour"]
    assert list(scene.optimise) == ["place", "colour"]


def test_the_samples_of_a_scene_file_can_be_overridden(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    assert scene.samples == 8
    few, many = load_scene(folder / "scene.toml", samples=1), load_scene(folder / "scene.toml", samples=64)
    assert (few.samples, many.samples) == (1, 64)
    noises = []
    for scene in (few, many):
        first, second = (scene.renderer.render(scene.renderer.parameters(), seed=seed) for seed in (0, 1))
        noises.append(np.linalg.norm(first - second))
    assert noises[0] > 4.0 * noises[1]  # a factor of 8, if samples are independent

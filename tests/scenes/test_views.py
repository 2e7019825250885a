"""Scene files with several views."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import SceneError
from loi_core.io.images import read_image, write_png
from loi_core.renderers import Disks
from loi_core.report import write_results
from loi_core.scenes.experiment import run_scene
from loi_core.scenes.reading import load_scene

SCENE = """\
[renderer]
name = "disks"
positions = [[10, 6]]
radii = [3]
colours = [[0.9, 0.2, 0.1]]

[views.near]
target = "near.png"

[views.far]
target = "far.png"
weights = "mask.png"
renderer = { radii = [2], colours = [[0.1, 0.6, 0.9]] }

[optimise.positions]
initial = [[4, 12]]
lower = 0
upper = 16
truth = [[10, 6]]

[objective]
compare = ["pixel_l2"]

[fit]
steps = 60
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    first = Disks(16, 16, [[10, 6]], 3.0, [[0.9, 0.2, 0.1]])
    second = Disks(20, 24, [[10, 6]], 2.0, [[0.1, 0.6, 0.9]])
    write_png(tmp_path / "near.png", first.render(first.parameters()))
    write_png(tmp_path / "far.png", second.render(second.parameters()))
    write_png(tmp_path / "mask.png", np.ones((20, 24, 3)))
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def test_each_view_has_its_own_target_weights_and_options(scene: Path) -> None:
    loaded = load_scene(scene)
    assert list(loaded.views) == ["near", "far"]
    first, second = loaded.views.values()
    assert first.target.image.shape == (16, 16, 3)
    assert second.target.image.shape == (20, 24, 3)
    assert first.target.weights is None
    assert second.target.weights is not None
    assert [float(view.renderer.parameters()["radii"][0]) for view in (first, second)] == [3.0, 2.0]


@pytest.mark.parametrize("fit_lines", ["", "views_per_step = 1\n"])
def test_a_scene_of_views_is_fitted_and_fixed_parameters_belong_to_each_view(scene: Path, fit_lines: str) -> None:
    scene.write_text(SCENE + fit_lines)
    loaded = load_scene(scene)
    trial = run_scene(loaded)[0]
    assert trial.result is not None
    np.testing.assert_allclose(trial.result.best_params["positions"], [[10, 6]], atol=0.1)
    for name, view in loaded.views.items():
        np.testing.assert_allclose(trial.result.image[name], view.target.image, atol=0.05)
    assert all(frame.shape == (20, 16 + 4 + 24, 3) for _, frame in trial.frames)


def test_the_command_shows_views_side_by_side(scene: Path) -> None:
    assert main(["fit", str(scene)]) == 0
    results = scene.parent / "scene-result"
    for name in ("target", "initial", "final", "error"):
        assert read_image(results / f"{name}.png").shape == (20, 44, 3)
    np.testing.assert_array_equal(read_image(results / "target.png")[:16, :16], read_image(scene.parent / "near.png"))
    result = json.loads((results / "result.json").read_text())
    assert result["views"] == ["near", "far"]
    assert result["trials"][0]["psnr"] > 30.0
    assert "views, from left to right: near, far" in (results / "report.html").read_text()


def test_an_interrupted_fit_shows_every_view(scene: Path) -> None:
    scene.write_text(SCENE + "views_per_step = 1\n")

    def stop(name: str, step: int, value: float) -> None:
        if step == 7:
            raise KeyboardInterrupt

    loaded = load_scene(scene)
    trials = run_scene(loaded, progress=stop)
    assert trials[0].error == "interrupted"
    result = write_results(loaded, trials)
    assert result["trials"][0]["steps_done"] == 8
    assert read_image(loaded.output / "final.png").shape == (20, 44, 3)
    assert read_image(loaded.output / "final.png")[:, 20:].max() > 0.3  # the second view, too


def test_a_scene_of_views_is_resumed(scene: Path) -> None:
    assert main(["fit", str(scene), "--steps", "30"]) in (0, 3)
    assert main(["fit", str(scene), "--resume", "--steps", "60"]) in (0, 3)
    history = (scene.parent / "scene-result" / "history.csv").read_text().splitlines()
    assert len(history) == 61


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('target = "far.png"\n', "", "[views.far] `target` is missing"),
        ("[renderer]", 'target = "near.png"\n[renderer]', "`target` and [views] exclude each other"),
        ("radii = [2]", 'name = "warp"', "`name` of the renderer is the same for all views"),
        ("[views.far]\n", '[views."a b"]\n', "views are named by letters, digits"),
        ('weights = "mask.png"', "mask = 3", "[views.far] unknown key `mask`"),
        ("[fit]\n", "[fit]\nviews_per_step = 3\n", "`views_per_step` must be a whole number from 1 to 2, got 3"),
        ("radii = [2]", "radii = [[2]]", "[views.far.renderer]"),
        (
            "radii = [2], colours = [[0.1, 0.6, 0.9]]",
            "radii = [2, 2], positions = [[1, 1], [2, 2]], colours = [[1, 1, 1], [1, 1, 1]]",
            "'positions' has shape (1, 2) in one view, and (2, 2) in 'far'",
        ),
    ],
)
def test_an_invalid_view_is_refused(old: str, new: str, message: str, scene: Path) -> None:
    assert old in SCENE
    scene.write_text(SCENE.replace(old, new))
    with pytest.raises(SceneError, match=re.escape(message)):
        load_scene(scene)

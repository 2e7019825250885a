"""Scene files can enable blurred gradients for every renderer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import SceneError
from loi_core.renderers import BlurredRenderer
from loi_core.scenes.experiment import run_scene
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK, START, lay_out_disk

SCENE = f"""\
target = "target.png"
output = "result"

{DISK}
[renderer.blur]

{START}
[fit]
steps = 60
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    lay_out_disk(tmp_path, SCENE)
    return tmp_path


def test_optimised_parameters_are_blurred_by_two_pixels_by_default(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    assert isinstance(scene.renderer, BlurredRenderer)
    assert scene.renderer.names == ("positions",)
    assert scene.renderer.sigma["positions"] == pytest.approx(2.0, rel=0.5)  # a disk's position is in pixels


def test_every_key_of_a_blur_can_be_set(folder: Path) -> None:
    table = (
        '[renderer.blur]\nnames = ["radii"]\nsigma = { radii = 0.5 }\nfinal_sigma = "1 px"\npairs = 2\ntogether = true'
    )
    (folder / "scene.toml").write_text(SCENE.replace("[renderer.blur]", table))
    renderer = load_scene(folder / "scene.toml").renderer
    assert isinstance(renderer, BlurredRenderer)
    assert renderer.names == ("radii",)
    assert renderer.sigma == {"radii": 0.5}


def test_a_blurred_fit_of_a_scene_converges(folder: Path) -> None:
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    params = json.loads((folder / "result" / "parameters.json").read_text())
    np.testing.assert_allclose(params["positions"], [[10.0, 6.0]], atol=0.3)


def test_an_interrupted_blurred_fit_is_resumed_to_the_bit(folder: Path) -> None:
    path, file = folder / "scene.toml", folder / "state.npz"
    path.write_text(SCENE.replace("steps = 60", "steps = 30"))

    def stop(objective: str, step: int, value: float) -> None:
        if step == 20:  # while sigma falls
            raise KeyboardInterrupt

    (whole,) = run_scene(load_scene(path))
    (interrupted,) = run_scene(load_scene(path), checkpoint=file, progress=stop)
    assert interrupted.error == "interrupted"
    (resumed,) = run_scene(load_scene(path), checkpoint=file, resume=True)
    assert whole.result is not None
    assert resumed.result is not None
    np.testing.assert_array_equal(resumed.result.params["positions"], whole.result.params["positions"])
    assert [step.value for step in resumed.result.history] == [step.value for step in whole.result.history]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("sigm = 1", r"\[renderer.blur\] unknown key `sigm`; did you mean `sigma`\?"),
        ("sigma = 0", r"\[renderer.blur\] `sigma` of 'positions' must be a finite number, more than 0, .* got 0"),
        ('final_sigma = "wide"', r"\[renderer.blur\] `final_sigma` of 'positions' .* got 'wide'"),
        ("sigma = { radii = 1 }", r"\[renderer.blur\] `sigma` must have 'positions', got 'radii'"),
        ('names = ["place"]', r"\[renderer.blur\] `names` must be of positions, radii, colours, got 'place'"),
        ('names = "radii"', r"\[renderer.blur\] `names` must be a list of names of parameters, got 'radii'"),
        ("pairs = 0", r"\[renderer.blur\] `pairs` must be a whole number, 1 or more, got 0"),
        ('together = "yes"', r"\[renderer.blur\] `together` must be true or false, got 'yes'"),
    ],
)
def test_an_error_in_a_blur_names_the_key(folder: Path, table: str, message: str) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("[renderer.blur]", f"[renderer.blur]\n{table}"))
    with pytest.raises(SceneError, match=message):
        load_scene(folder / "scene.toml")


def test_a_blur_is_a_table(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("[renderer.blur]", "").replace("radii", "blur = 3\nradii"))
    with pytest.raises(SceneError, match=r"\[renderer\] `blur` must be a table, got 3"):
        load_scene(folder / "scene.toml")

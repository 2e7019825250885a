"""Scene files: their content, and a one-line error for every mistake."""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from loi_core import GaussianPyramid, ImageObjective, LogTone, LOIObjective, PixelL2, ScaleSpace
from loi_core.cli import main
from loi_core.errors import LoiError, SceneError
from loi_core.fitting.parameters import bounds_of, starting_parameters
from loi_core.plugins import registry
from loi_core.renderers import Disks
from loi_core.scenes.experiment import run_scene
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK_TO_FIND, lay_out_disk

if TYPE_CHECKING:
    KnownToTypeCheckers = str

SCENE = f"""\
target = "target.png"
output = "result"

{DISK_TO_FIND}
[objective]
compare = ["pixel_l2"]

[fit]
steps = 6
learning_rate = 1
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    lay_out_disk(tmp_path, SCENE)
    return tmp_path


def test_a_scene_becomes_objects(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    assert isinstance(scene.renderer, Disks)
    assert scene.renderer.parameters()["radii"].tolist() == [3.0]
    assert scene.target.shape == (16, 16, 3)
    assert scene.output == folder / "result"
    assert list(scene.objectives) == ["loi", "pixel_l2"]
    loi = scene.objectives["loi"]
    assert isinstance(loi, LOIObjective)
    assert loi.scales == ScaleSpace(1, (2, 6), 0.125)
    assert isinstance(scene.objectives["pixel_l2"], PixelL2)
    assert scene.optimise["positions"].initial == [[4, 12]]
    assert scene.truth["positions"].tolist() == [[10.0, 6.0]]
    assert (scene.fit.steps, scene.fit.decay) == (6, "cosine")


def test_a_row_of_bounds_applies_to_every_row(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("lower = 0", "lower = [0, 1]"))
    scene = load_scene(folder / "scene.toml")
    params = starting_parameters(scene.renderer, scene.optimise)
    assert bounds_of(params, scene.optimise).lower["positions"].tolist() == [[0.0, 1.0]]


def test_missing_keys_of_a_scene_have_defaults(folder: Path) -> None:
    text = SCENE[: SCENE.index("[scales]")].replace('output = "result"\n', "")
    (folder / "scene.toml").write_text(text)
    scene = load_scene(folder / "scene.toml")
    assert scene.output == folder / "scene-result"
    assert list(scene.objectives) == ["loi"]
    assert scene.objectives["loi"].scales == ScaleSpace.for_image(16, 16)  # type: ignore[attr-defined]  # a LOIObjective


def test_presets_baselines_and_boundaries_can_be_named(folder: Path) -> None:
    text = SCENE.replace("sigma = 1\nalpha = [2, 6]\nbeta = 0.125", 'preset = "path"\nboundary = "zero"')
    text = text.replace('compare = ["pixel_l2"]', 'name = "gaussian_pyramid"\ncompare = ["loi"]')
    (folder / "scene.toml").write_text(text)
    scene = load_scene(folder / "scene.toml")
    assert [type(objective) for objective in scene.objectives.values()] == [GaussianPyramid, LOIObjective]
    assert scene.objectives["loi"].scales == ScaleSpace.paper("path", boundary="zero")  # type: ignore[attr-defined]


def test_an_option_annotated_as_a_path_is_relative_to_the_scene(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments: dict[str, Any] = {}

    def factory(
        mesh: str | Path, note: KnownToTypeCheckers, cache: Path | None = None, texture: Path | None = None
    ) -> Disks:
        arguments.update(mesh=mesh, note=note, cache=cache, texture=texture)
        return Disks(16, 16, [[10, 6]], 3.0, [[0.9, 0.2, 0.1]])

    options = 'mesh = "a/b.obj"\nnote = "a/b"\ncache = "/c"'
    (folder / "scene.toml").write_text(
        SCENE[: SCENE.index("positions")] + options + SCENE[SCENE.index("\n\n[optimise") :]
    )
    monkeypatch.setattr("loi_core.scenes.renderers.load_renderer", lambda name: factory)
    load_scene(folder / "scene.toml")
    assert arguments == {"mesh": folder / "a/b.obj", "note": "a/b", "cache": Path("/c"), "texture": None}
    factory.__annotations__ = {"mesh": str | Path, "note": str, "cache": Path}  # not as text
    load_scene(folder / "scene.toml")
    assert arguments == {"mesh": folder / "a/b.obj", "note": "a/b", "cache": Path("/c"), "texture": None}


MISTAKES: list[tuple[str, str, str]] = [
    ('target = "target.png"', "", "`target` is missing"),
    ('target = "target.png"', "target = 3", "`target` must be a text"),
    ('target = "target.png"', 'target = "none.png"', "none.png: no such image file"),
    ('target = "target.png"', 'targt = "target.png"', "unknown key `targt`; did you mean `target`?"),
    ('target = "target.png"', 'target = "scene.toml"', "images must end in .png"),
    ('output = "result"', "output = 1", "`output` must be a text"),
    (
        'name = "disks"',
        'name = "spheres"',
        (
            "no renderer is called 'spheres'; installed are disks, disks-jax, disks-torch, mesh-torch, mitsuba, "
            "mitsuba-planned, vector-torch, warp, warp-torch"
        ),
    ),
    ('name = "disks"', "", "[renderer] `name` is missing"),
    ("radii = [3]", "radius = [3]", "[renderer] unknown key `radius`"),
    ("radii = [3]", "radii = [3, 4]", "[renderer] `radii` must have shape (1,), got (2,)"),
    ("radii = [3]", 'radii = [3]\nimages = "x"', "`images` must be a table"),
    ("radii = [3]", "radii = [3]\nheight = 20", "[renderer] `height` must be that of the target, 16, got 20"),
    ("[optimise.positions]", "[optimise.position]", "[optimise] unknown key `position`; did you mean `positions`?"),
    ("initial = [[4, 12]]", "initial = [4, 1, 2]", "[optimise.positions] `initial` must be one number or fill shape"),
    ("initial = [[4, 12]]", 'initial = "left"', "[optimise.positions] `initial` must be numbers"),
    ("initial = [[4, 12]]", "initial = [[4, 99]]", "[optimise] `initial` of 'positions' must lie within its bounds"),
    ("lower = 0", "lower = 99", "`lower` of 'positions' must not exceed `upper`"),
    ("lower = 0", "lowest = 0", "[optimise.positions] unknown key `lowest`"),
    ("lower = 0", "lower = nan", "`lower` must be numbers, got nan"),
    ("lower = 0", "learning_rate = 0", "`learning_rate` must be a finite number, more than 0"),
    ("sigma = 1", "sigma = -1", "[scales] `sigma` must be a finite number, 0 or more, got -1"),
    ("sigma = 1", 'preset = "path"', "[scales] `preset` and `alpha` exclude each other"),
    ("beta = 0.125", 'boundary = "mirror"', "[scales] `boundary` must be one of"),
    ("beta = 0.125", "gamma = 2", "[scales] unknown key `gamma`"),
    ('compare = ["pixel_l2"]', 'compare = "pixel_l2"', "[objective] `compare` must be a list"),
    (
        'compare = ["pixel_l2"]',
        'compare = ["ssim"]',
        "[objective] objectives are loi, pixel_l2, gaussian_pyramid, ms_ssim",
    ),
    ('compare = ["pixel_l2"]', 'accuracy = "perfect"', "[objective] `accuracy` must be one of"),
    ('compare = ["pixel_l2"]', 'nan_policy = "keep"', "[objective] `nan_policy` must be one of"),
    (
        'compare = ["pixel_l2"]',
        'name = "pixel_l2"\ncolours = "differences"',
        "[objective] `colours` is an option of loi",
    ),
    ('compare = ["pixel_l2"]', 'colours = "grey"', "[objective] `colours` must be 'channels' or 'differences'"),
    ('compare = ["pixel_l2"]', "tone = 3", "[objective] `tone` must be a table, got 3"),
    ('compare = ["pixel_l2"]', "tone = {}", "[objective.tone] `peak` is missing"),
    ('compare = ["pixel_l2"]', "tone = { peak = 1, gamma = 2 }", "[objective.tone] unknown key `gamma`"),
    ('compare = ["pixel_l2"]', "tone = { peak = 0 }", "[objective.tone] `peak` of a tone curve must be a number from"),
    ("steps = 6", "steps = 0", "[fit] `steps` must be a whole number"),
    ("steps = 6", "views_per_step = 1", "[fit] `views_per_step` must be left out of a scene without [views], got 1"),
    ("steps = 6", "step = 6", "[fit] unknown key `step`; did you mean `steps`?"),
    ("learning_rate = 1", 'learning_rate = "fast"', "[fit] `learning_rate` must be a finite number"),
    ("learning_rate = 1", "learning_rate = 1 1", "not a readable TOML file"),
    ("[fit]", "[[fit]]", "`fit` must be a table"),
    ('output = "result"', 'output = "."', "`output` must be a folder of its own"),
    ('output = "result"', 'output = "target.png"', "`output` must lead to a folder that can be written to"),
    ('output = "result"', 'output = "a\\u0000b"', "`output` must be a text"),
    ("confine = true", 'confine = "no"', "[renderer] `confine` must be true or false, got 'no'"),
    ("radii = [3]", "radii = [-3]", "[renderer] `radii` must be 0 or more, got -3"),
    ("radii = [3]", "radii = [true]", "[renderer] `radii` must be numbers"),
    ("radii = [3]", 'positions = [["a", "b"]]\nradii = [3]', "not a readable TOML file"),
    ("truth = [[10, 6]]", "truth = inf", "`truth` must be finite, got inf"),
    ("initial = [[4, 12]]", "initial = [[4, true]]", "`initial` must be numbers"),
    ("initial = [[4, 12]]", "initial = [[4, 12], [1]]", "rows of different lengths"),
    ("sigma = 1", "sigma = 1" + "0" * 400, "[scales] `sigma` must be a finite number"),
    ("beta = 0.125", "beta = 1e-9", "[scales] `beta` must divide the bounds into at least 1 and at most 65536 levels"),
    ("beta = 0.125", "bounds = [false, true]", "[scales] `bounds` must be two finite intensities"),
    ("learning_rate = 1", "learning_rate = 1" + "0" * 400, "[fit] `learning_rate` must be a finite number"),
    ("lower = 0", "learning_rate = 1" + "0" * 400, "`learning_rate` must be a finite number"),
    ('compare = ["pixel_l2"]', "accuracy = 1" + "0" * 400, "[objective] `accuracy` must be one of"),
    ("[fit]", '"a\\nb" = 1\n[fit]', "unknown key `a b`"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES, ids=[f"{new or 'no ' + old}" for old, new, _ in MISTAKES])
def test_a_mistake_in_a_scene_is_one_line_with_exit_code_2(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new, 1))
    files = sorted(folder.rglob("*"))
    assert main(["fit", str(folder / "scene.toml")]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert err.startswith("loi: ")
    assert err.count("\n") == 1
    assert out == ""
    assert sorted(folder.rglob("*")) == files


def test_a_tone_curve_is_part_of_every_objective(folder: Path) -> None:
    assert load_scene(folder / "scene.toml").tone is None
    line = 'compare = ["pixel_l2", "gaussian_pyramid"]\ntone = { peak = 2, compression = 50 }'
    (folder / "scene.toml").write_text(SCENE.replace('compare = ["pixel_l2"]', line))
    scene = load_scene(folder / "scene.toml")
    assert scene.tone == LogTone(2.0, 50.0)
    assert len(scene.objectives) == 3
    assert all(
        isinstance(objective, ImageObjective) and objective.tone == scene.tone
        for objective in scene.objectives.values()
    )


def test_the_option_colours_applies_to_loi_only(folder: Path) -> None:
    line = 'compare = ["pixel_l2"]\ncolours = "differences"'
    text = SCENE.replace('compare = ["pixel_l2"]', line)
    (folder / "scene.toml").write_text(text.replace("sigma = 1\nalpha = [2, 6]\nbeta = 0.125", ""))
    objective = load_scene(folder / "scene.toml").objectives["loi"]
    assert isinstance(objective, LOIObjective)
    assert objective.colours == "differences"
    assert objective.has_default_scales


def test_objectives_of_other_packages_are_available_by_name(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    points = [
        EntryPoint("mine", "loi_core:PixelL2", registry.OBJECTIVES.name),
        EntryPoint("absent", "no_such_module:Objective [gpu]", registry.OBJECTIVES.name),
        EntryPoint("refuses", "odd_objectives:refuse", registry.OBJECTIVES.name),
        EntryPoint("number", "odd_objectives:number", registry.OBJECTIVES.name),
        EntryPoint("../up", "loi_core:PixelL2", registry.OBJECTIVES.name),  # would name a folder elsewhere
    ]
    (folder / "odd_objectives.py").write_text(
        "def refuse(reference, **_):\n    raise SystemExit('no licence')\nnumber = lambda reference, **_: 3.0\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    installed = importlib.metadata.entry_points
    monkeypatch.setattr(
        registry, "entry_points", lambda group: points if group == registry.OBJECTIVES.name else installed(group=group)
    )
    path = folder / "scene.toml"
    path.write_text(SCENE.replace('["pixel_l2"]', '["mine"]'))
    assert isinstance(load_scene(path).objectives["mine"], PixelL2)
    assert main(["fit", str(path)]) in FINISHED
    assert (folder / "result" / "compare" / "mine" / "final.png").exists()
    capsys.readouterr()
    for name, message in (
        (
            "absent",
            "objective 'absent' of unknown cannot be used: ModuleNotFoundError: No module named 'no_such_module'",
        ),
        ("refuses", "[objective] refuses refused: SystemExit: no licence"),
        ("number", "[objective] number made a float, which is not an objective"),
        ("../up", "ms_ssim, absent, mine, number, refuses, got '../up'"),
    ):
        path.write_text(SCENE.replace('["pixel_l2"]', f'["{name}"]'))
        assert main(["fit", str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line


def test_a_missing_or_binary_scene_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such scene file"):
        load_scene(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    with pytest.raises(SceneError, match="not a readable TOML file") as caught:
        load_scene(tmp_path / "binary.toml")
    assert isinstance(caught.value, LoiError)


def test_fit_writes_all_results_and_prints_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(folder / "scene.toml"), "--json"]) in FINISHED
    printed: dict[str, Any] = json.loads(capsys.readouterr().out)
    result = folder / "result"
    assert Path(printed["report"]) == result / "report.html"
    files = {str(path.relative_to(result)) for path in result.rglob("*") if path.is_file()}
    assert files >= {
        *("parameters.json", "history.csv", "result.json", "report.html", "checkpoint.npz"),
        *("initial.png", "final.png", "target.png", "error.png"),
        *("compare/pixel_l2/final.png", "compare/pixel_l2/history.csv", "frames/000000.png"),
    }
    best = json.loads((result / "parameters.json").read_text())
    assert best["positions"] == printed["trials"][0]["parameters"]["positions"]
    assert (result / "history.csv").read_text().splitlines()[
        0
    ] == "step,value,gradient_norm,rate,seconds,psnr,stage,positions[0],positions[1]"
    assert len((result / "history.csv").read_text().splitlines()) == 7
    page = (result / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 8
    assert "http://" not in page
    assert "https://" not in page
    assert printed["trials"][0]["parameter_errors"]["positions"] < 8.0
    assert not any(result.rglob(".*"))


def test_a_report_can_be_written_again_from_results_only(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["fit", str(folder / "scene.toml"), "--output", str(folder / "elsewhere")])
    page = folder / "elsewhere" / "report.html"
    content = page.read_text()
    page.unlink()
    assert main(["report", str(folder / "elsewhere")]) == 0
    assert page.read_text() == content
    assert main(["report", str(folder)]) == 2
    assert "no result.json there" in capsys.readouterr().err


def test_a_resumed_fit_keeps_its_pictures_and_history(folder: Path) -> None:
    main(["fit", str(folder / "scene.toml")])
    result = folder / "result"
    whole = np.load(result / "checkpoint.npz")["params/positions"]
    pictures = {path.name for path in (result / "frames").iterdir()}
    history = (result / "history.csv").read_text()
    assert main(["fit", str(folder / "scene.toml"), "--resume"]) in FINISHED
    np.testing.assert_array_equal(np.load(result / "checkpoint.npz")["params/positions"], whole)
    assert {path.name for path in (result / "frames").iterdir()} == pictures
    assert (result / "history.csv").read_text() == history


def test_a_resumed_fit_does_not_read_the_psnr_of_its_history_file(folder: Path) -> None:
    main(["fit", str(folder / "scene.toml")])
    history = folder / "result" / "history.csv"
    text = history.read_text()
    rows = text.splitlines()
    edited = rows[4].split(",")
    edited[5] = "99.0"
    history.write_text("\n".join([*rows[:3], ",".join(edited), *rows[5:]]))
    main(["fit", str(folder / "scene.toml"), "--resume"])
    assert history.read_text() == text


def test_only_overwrite_replaces_a_fit_that_took_long(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["fit", str(folder / "scene.toml"), "--steps", "3"]
    assert main(arguments) in FINISHED
    assert main(arguments) in FINISHED
    monkeypatch.setattr("loi_core.cli.fit.MAX_REPLACED_SECONDS", 0.0)
    files = {path: path.read_bytes() for path in (folder / "result").rglob("*") if path.is_file()}
    assert main(arguments) == 2
    assert "`--overwrite` replaces it, `--resume` continues it" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (folder / "result").rglob("*") if path.is_file()} == files
    for option in ("--resume", "--overwrite"):
        assert main([*arguments, option]) in FINISHED


def test_ctrl_c_after_a_fit_keeps_the_fit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, value_and_grad = itertools.count(), PixelL2.value_and_grad

    def interrupted(self: PixelL2, image: Any, **options: Any) -> Any:
        if next(calls) == 2:
            raise KeyboardInterrupt
        return value_and_grad(self, image, **options)

    monkeypatch.setattr(PixelL2, "value_and_grad", interrupted)
    trials = run_scene(load_scene(folder / "scene.toml"))
    assert [(trial.objective, trial.error) for trial in trials] == [("loi", ""), ("pixel_l2", "interrupted")]
    assert trials[0].result is not None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("steps = 6", "steps = 4", "`checkpoint` was made with steps = 6, this fit has 4"),
        ("learning_rate = 1", "learning_rate = 2", "`checkpoint` was made with learning rates"),
        ("upper = 16", "upper = 15", "`checkpoint` was made with other bounds"),
        ("sigma = 1", "sigma = 2", "another objective, reference or scene"),
        ("radii = [3]", "radii = [4]", "another scene: 'radii', which does not move, differs"),
    ],
)
def test_a_checkpoint_of_a_different_fit_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    main(["fit", str(folder / "scene.toml")])
    (folder / "scene.toml").write_text(SCENE.replace(old, new))
    capsys.readouterr()
    assert main(["fit", str(folder / "scene.toml"), "--resume"]) == 2
    assert message in capsys.readouterr().err


def test_a_failed_fit_reports_the_error_and_removes_earlier_results(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    main(["fit", str(folder / "scene.toml")])

    render_vjp = Disks.render_vjp
    monkeypatch.setattr(Disks, "render", lambda self, params, *, seed=0: render_vjp(self, params)[0])
    monkeypatch.setattr(
        Disks, "render_vjp", lambda self, params, *, seed=0: (render_vjp(self, params)[0] * np.nan, None)
    )
    assert main(["fit", str(folder / "scene.toml")]) == 1
    assert "step 0: the render is not finite" in capsys.readouterr().err
    result = folder / "result"
    assert not (result / "final.png").exists()
    assert not list((result / "frames").iterdir())
    assert "not finite" in (result / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "stop"),
    [
        ([], KeyboardInterrupt()),
        (["--resume", "--steps", "20"], KeyboardInterrupt()),
        (["--resume", "--steps", "20"], RuntimeError("the device is gone")),
    ],
)
def test_a_fit_stopped_before_its_first_step_keeps_earlier_results(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    stop: BaseException,
) -> None:
    main(["fit", str(folder / "scene.toml")])
    contents = {path: path.read_bytes() for path in (folder / "result").rglob("*") if path.is_file()}
    calls, render_vjp = itertools.count(), Disks.render_vjp

    def render(self: Disks, params: Any, *, seed: int = 0) -> Any:
        if next(calls) == 1:  # after the start: the first step, or the best of the checkpoint
            raise stop
        return render_vjp(self, params, seed=seed)

    monkeypatch.setattr(Disks, "render_vjp", render)
    assert main(["fit", str(folder / "scene.toml"), *arguments]) == 1
    printed = capsys.readouterr().err.splitlines()
    if isinstance(stop, KeyboardInterrupt):
        assert printed == [
            "loi: loi (ours): interrupted; `--resume` continues the fit",
            f"loi: {folder / 'result'}: the results of an earlier fit are left as they are",
        ]
    else:
        assert printed == ["loi: rendering the best of the checkpoint failed: RuntimeError: the device is gone"]
    assert {path: path.read_bytes() for path in (folder / "result").rglob("*") if path.is_file()} == contents


@pytest.mark.parametrize(
    "content",
    [
        *("{}", "[]", "3", "[" * 100000, '{"title": "a", "scene": "b", "steps": 1, "trials": []}'),
        *(
            f'{{"title": "a", "scene": "b", "steps": 1, "trials": [{trial}]}}'
            for trial in ("3", "{}", '{"objective": "../x"}')
        ),
        '{"title": "a", "scene": "b", "steps": "q", "trials": [{"objective": "loi"}]}',
    ],
)
def test_a_foreign_result_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str) -> None:
    (tmp_path / "result.json").write_text(content)
    assert main(["report", str(tmp_path)]) == 2
    assert "not the result of `loi fit`" in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radii = [3]\n", "", "`radii` is missing; disks needs it"),
        ('name = "disks"', "name = disks", 'texts stand in quotes, name = "text"'),
    ],
)
def test_a_missing_or_unquoted_value_is_named(folder: Path, old: str, new: str, message: str) -> None:
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new))
    with pytest.raises(SceneError) as caught:
        load_scene(folder / "scene.toml")
    assert message in str(caught.value)


def test_exit_status_and_verdict_report_convergence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = str(folder / "scene.toml")
    assert main(["fit", scene, "--steps", "1"]) == 3
    assert re.search(
        r"^loi \(ours\): (stalled|still falling|at a bound): \d+% of the loss", capsys.readouterr().out, re.M
    )
    assert main(["fit", scene, "--steps", "60", "--resume"]) == 0
    assert "loi (ours): converged" in capsys.readouterr().out
    result = json.loads((folder / "result" / "result.json").read_text())
    assert result["trials"][0]["diagnosis"]["verdict"] == "converged"
    assert main(["fit", scene, "--steps", "0"]) == 2
    assert "`steps` must be a whole number" in capsys.readouterr().err

"""The command line: the demo recovers its scenes; the doctor and the list of renderers report the true state."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from loi_core import __version__
from loi_core.cli import doctor, main
from loi_core.cli.bundled import copy_scene
from loi_core.errors import RendererNotFoundError
from loi_core.plugins import registry
from loi_core.renderers import Disks
from loi_core.support.installed import how_to_install
from tests.helpers import FINISHED
from tests.strategies import THOROUGH, thorough

DEMO_WITHOUT_CRATE = """
import sys
from loi_core.cli import demo, main
del demo.REQUIREMENTS["crate"]
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the JSON of the demo; only the thorough tier fits its slowest scene, the crate."""
    program = ["-m", "loi_core"] if THOROUGH else ["-c", DEMO_WITHOUT_CRATE]
    arguments = ["demo", "--output", str(tmp_path_factory.mktemp("demo")), "--json"]
    done = subprocess.run([sys.executable, *program, *arguments], capture_output=True, check=True)
    return dict(json.loads(done.stdout))


def errors(demo: dict[str, Any], scene: int, objective: str) -> dict[str, float]:
    (trial,) = (trial for trial in demo["scenes"][scene]["trials"] if trial["objective"] == objective)
    return dict(trial["parameter_errors"])


def test_the_demo_finds_the_disks_within_a_quarter_pixel(demo: dict[str, Any]) -> None:
    assert errors(demo, 0, "loi")["positions"] < 0.25


def test_the_demo_finds_the_photograph_as_accurately_as_the_readme_says(demo: dict[str, Any]) -> None:
    error = errors(demo, 1, "loi")
    assert error["translation"] < 0.1
    assert error["rotation"] < 0.1
    assert error["scale"] < 0.01 * 0.9


@pytest.mark.parametrize(("scene", "name"), [(0, "positions"), (1, "translation")])
def test_the_demo_shows_pixel_l2_failing_from_the_same_start(demo: dict[str, Any], scene: int, name: str) -> None:
    assert errors(demo, scene, "pixel_l2")[name] > 20.0
    first, second = demo["scenes"][scene]["trials"][:2]
    assert first["psnr_initial"] == second["psnr_initial"]
    assert first["psnr"] > second["psnr"] + 5.0


def test_the_demo_finds_a_ball_in_mitsuba_that_does_not_overlap_its_target(demo: dict[str, Any]) -> None:
    pytest.importorskip("loi_mitsuba")  # before mitsuba, whose LLVM the doctor judges in this process
    error, pixels = errors(demo, 2, "loi"), errors(demo, 2, "pixel_l2")
    assert max(error.values()) < 0.15  # about a pixel
    assert pixels["x"] > 1.0


@thorough
def test_the_demo_finds_a_mesh_on_torch_that_does_not_overlap_its_target(demo: dict[str, Any]) -> None:
    pytest.importorskip("torch")
    error, pixels = errors(demo, -1, "loi"), errors(demo, -1, "pixel_l2")
    assert error["position"] < 0.09  # about a pixel
    assert error["rotation"] < 2.0
    assert pixels["position"] > 1.0


def test_the_crate_of_the_demo_can_be_fitted(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    assert main(["fit", str(copy_scene("crate", tmp_path)), "--steps", "2"]) in FINISHED


def test_the_demo_names_the_command_that_installs_each_missing_renderer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("loi_mitsuba", "loi_torch", "loi_torch.mesh"):  # also where an earlier test has imported them
        monkeypatch.setitem(sys.modules, name, None)  # as if its import failed
    monkeypatch.setattr("loi_core.cli.demo.run_and_write", lambda scene, **_: {"title": scene.title, "trials": []})
    monkeypatch.setattr("loi_core.cli.demo.write_page", lambda page: page)
    monkeypatch.setattr("loi_core.cli.demo.write_index", lambda page, folders, title: page)
    assert main(["demo", "--output", str(tmp_path), "--json"]) == 0
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    for line, package in zip(lines, ("Mitsuba", "torch"), strict=True):
        assert line.startswith(f"loi: the scene with {package} is left out; ")
        assert "pip install" in line
    titles = [result["title"] for result in json.loads(printed.out)["scenes"]]
    assert titles == ["Three disks", "A photograph, darker and noisy"]


def test_the_demo_writes_one_page_of_pictures(demo: dict[str, Any]) -> None:
    page = Path(demo["report"])
    assert page.name == "index.html"
    assert page.read_text().count("data:image/png;base64,") > 30


def test_a_scene_of_the_demo_can_be_fitted_again(demo: dict[str, Any]) -> None:
    scene = Path(demo["report"]).parent / "disks" / "scene.toml"
    text = re.sub(r"steps = \d+", "steps = 2", scene.read_text())
    scene.write_text(text)
    assert main(["fit", str(scene)]) in FINISHED


def test_the_demo_refuses_an_output_that_cannot_be_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "a\0b"):
        assert main(["demo", "--output", str(path)]) == 2
        assert "`--output` must" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code"),
    [(["--version"], 0), (["--help"], 0), (["fit", "--help"], 0), ([], 2), (["fly"], 2), (["fit"], 2)],
)
def test_malformed_calls_exit_with_2(arguments: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == code
    assert "Traceback" not in capsys.readouterr().err


def test_the_version_is_the_version_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--version"])
    assert capsys.readouterr().out.strip() == f"loi {__version__}"


def test_the_doctor_reports_every_installed_part_as_ok(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    findings = {finding["name"]: finding for finding in json.loads(capsys.readouterr().out)}
    for name in (
        "python",
        "numpy",
        "torch",
        "jax",
        "kornia",
        "trimesh",
        "svgelements",
        "renderer disks",
        "renderer disks-jax",
        "renderer disks-torch",
        "renderer warp",
        "renderer warp-torch",
        "renderer mitsuba",
        "renderer mitsuba-planned",
        "LLVM",
        "threads",
    ):
        assert findings[name]["state"] == "ok", findings[name]
    assert main(["doctor"]) == 0
    assert "renderer disks" in capsys.readouterr().out


def test_the_doctor_names_the_fix_of_a_missing_or_broken_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "crooked.py").write_text("raise ImportError('libcrooked.so: no such file')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(doctor, "BACKENDS", {"torch": "no_such_module", "jax": "crooked"})
    assert main(["doctor", "--json"]) == 1
    findings = {finding["name"]: finding for finding in json.loads(capsys.readouterr().out)}
    assert (findings["torch"]["state"], findings["torch"]["fix"]) == ("missing", how_to_install("torch"))
    assert findings["jax"]["state"] == "broken"
    assert "libcrooked.so" in findings["jax"]["detail"]


def test_the_doctor_reports_numba_as_missing_or_as_switched_off(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "BACKENDS", {})

    def numba_finding() -> dict[str, str]:
        main(["doctor", "--json"])
        findings = json.loads(capsys.readouterr().out)
        return dict(next(finding for finding in findings if finding["name"] == "numba"))

    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "numba", None)
        finding = numba_finding()
        assert (finding["state"], finding["fix"]) == ("missing", "pip install numba")
        assert "several times as long" in finding["detail"]
    pytest.importorskip("numba")
    monkeypatch.setenv("LOI_COMPILED", "0")
    finding = numba_finding()
    assert finding["state"] == "note"
    assert "switched off by LOI_COMPILED=0" in finding["detail"]


def test_the_doctor_constructs_every_registered_objective(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "objectives_to_doctor.py").write_text(
        "from loi_core import PixelL2 as Sound\n"
        "from loi_core.errors import WeightsError\n"
        "def unlearned(reference, **options):\n    raise WeightsError('no weights; a word; pip install weights')\n"
        "def sick(reference, **options):\n    print('not JSON')\n    raise ZeroDivisionError('no reason')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    names = {"fine": "Sound", "unlearned": "unlearned", "sick": "sick", "absent": "absent"}
    points = [
        EntryPoint(name, f"objectives_to_doctor:{value}", registry.OBJECTIVES.name) for name, value in names.items()
    ]
    monkeypatch.setattr(registry, "entry_points", lambda *, group: points if group == registry.OBJECTIVES.name else [])
    assert main(["doctor", "--json"]) == 1
    findings = {finding["name"]: finding for finding in json.loads(capsys.readouterr().out)}
    assert findings["objective fine"]["state"] == "ok"
    unlearned = findings["objective unlearned"]
    assert (unlearned["state"], unlearned["detail"], unlearned["fix"]) == (
        "missing",
        "no weights; a word",
        "pip install weights",
    )
    assert findings["objective sick"]["state"] == findings["objective absent"]["state"] == "broken"
    assert "no reason" in findings["objective sick"]["detail"]


def test_renderers_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["renderers", "--json"]) == 0
    listed = {info["name"]: info for info in json.loads(capsys.readouterr().out)}
    assert listed["disks"] == {
        "name": "disks",
        "package": "loi",
        "version": __version__,
        "backend": "numpy",
        "target": "loi_core.renderers:Disks",
        "state": "ready",
        "problem": "",
        "fix": "",
    }
    assert registry.load_renderer("disks") is Disks


def test_a_bad_plugin_is_reported_by_name_and_isolated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "plugin_that_raises.py").write_text("raise RuntimeError('no licence\\nsecond line')\n")
    (tmp_path / "plugin_that_quits.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "plugin_with_an_odd_signature.py").write_text("def make(options, /): ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [
        EntryPoint("good", "loi_core.renderers:Disks", registry.RENDERERS.name),
        EntryPoint("raises", "plugin_that_raises:make", registry.RENDERERS.name),
        EntryPoint("quits", "plugin_that_quits:make", registry.RENDERERS.name),
        EntryPoint("absent", "no_such_module:make", registry.RENDERERS.name),
        EntryPoint("number", "math:pi", registry.RENDERERS.name),
        EntryPoint("odd", "plugin_with_an_odd_signature:make", registry.RENDERERS.name),
        EntryPoint("extra", "no_such_module:make [gpu]", registry.RENDERERS.name),
        EntryPoint("twice", "loi_core.renderers:Disks", registry.RENDERERS.name),
        EntryPoint("twice", "loi_core.renderers:Warp", registry.RENDERERS.name),
        EntryPoint("again", "loi_core.renderers:Warp", registry.RENDERERS.name),
        EntryPoint("again", "loi_core.renderers:Warp", registry.RENDERERS.name),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    states = [(info.name, info.state) for info in registry.available_renderers()]
    assert states == [
        *[("absent", "broken"), ("again", "ready"), ("extra", "missing"), ("good", "ready"), ("number", "broken")],
        *[("odd", "broken"), ("quits", "broken"), ("raises", "broken"), ("twice", "clash"), ("twice", "clash")],
    ]
    problems = {info.name: info.problem for info in registry.available_renderers()}
    assert problems["raises"] == "RuntimeError: no licence second line"
    assert "not a factory" in problems["number"]
    assert "takes `options` by position only" in problems["odd"]
    fixes = {info.name: info.fix for info in registry.available_renderers()}
    assert fixes["extra"] == "pip install 'unknown[gpu]'"
    assert fixes["good"] == ""
    assert "pip install" in fixes["raises"]
    assert registry.load_renderer("good") is Disks
    for name, says in (
        *(("raises", "no licence"), ("twice", "2 claim it; pip uninstall"), ("none", "no renderer is called 'none'")),
        ("extra", "pip install 'unknown\\[gpu\\]'"),
    ):
        with pytest.raises(RendererNotFoundError, match=says) as caught:
            registry.load_renderer(name)
        assert isinstance(caught.value, LookupError)

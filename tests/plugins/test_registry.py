"""Broken plugins are reported by name and leave the others usable."""

from __future__ import annotations

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import RendererError, SceneError
from loi_core.plugins import registry
from loi_core.renderers import Disks
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene
from tests.fuzz.scenes import SCENE, lay_out, to_toml

ODD = """
class Own(BaseException): pass
class OwnInterrupt(KeyboardInterrupt): pass
class Mute(Exception):
    def __str__(self): raise RuntimeError('mute')
class Touchy:
    def __getattr__(self, name): raise RuntimeError(name)
    def __call__(self, **options): return None
def __getattr__(name):
    if name == 'touchy': return Touchy()
    raise {'own': Own, 'interrupt': OwnInterrupt, 'mute': Mute}[name]
"""


def test_a_plugin_that_raises_anything_is_listed_as_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plugin_that_is_odd.py").write_text(ODD)
    monkeypatch.syspath_prepend(str(tmp_path))
    values = {name: f"plugin_that_is_odd:{name}" for name in ("own", "interrupt", "mute", "touchy")}
    values |= {"no value": "not a module!!", "nothing": ""}
    points = [EntryPoint(name, value, registry.RENDERERS.name) for name, value in values.items()]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    listed = {info.name: info for info in registry.available_renderers()}
    assert {name: info.state for name, info in listed.items()} == dict.fromkeys(values, "broken")
    assert listed["own"].problem == "Own"
    assert listed["mute"].problem == "Mute: its message cannot be printed"
    assert listed["no value"].problem == "'not a module!!' is not a module and an object in it"


def test_output_of_a_plugin_goes_to_standard_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plugin_that_greets.py").write_text("print('hello')\nmake = dict\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("greets", "plugin_that_greets:make", registry.RENDERERS.name)]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    assert main(["renderers", "--json"]) == 0
    out, err = capsys.readouterr()
    assert [renderer["state"] for renderer in json.loads(out)] == ["ready"]
    assert err == "hello\n"


@pytest.mark.parametrize("content", [b"[loi.renderers]\nno equals sign\n", b"\xff"], ids=["syntax", "encoding"])
def test_a_package_with_damaged_metadata_does_not_hide_the_others(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "damaged-1.0.dist-info").mkdir()
    (tmp_path / "damaged-1.0.dist-info" / "entry_points.txt").write_bytes(content)
    (tmp_path / "damaged-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: damaged\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    states = {info.name: info.state for info in registry.available_renderers()}
    assert states["damaged"] == "broken"
    assert states["disks"] == "ready"
    assert registry.load_renderer("disks") is Disks


class Empty:
    def parameters(self) -> Any:
        raise SystemExit(0)

    def render(self, params: Any, *, seed: int = 0) -> Any: ...

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any: ...


class Late(Empty):
    def parameters(self) -> Any:
        return {"positions": np.zeros((2, 2))}

    def render(self, params: Any, *, seed: int = 0) -> Any:
        raise SystemExit(0)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: None, SceneError, "foreign made a NoneType, which is not a renderer"),
        (lambda: sys.exit(0), SceneError, "foreign refused: SystemExit: 0"),
        (Empty, RendererError, r"Empty.parameters\(\) failed: SystemExit: 0"),
        (Late, RendererError, "rendering the start failed: SystemExit: 0"),
    ],
)
def test_a_broken_renderer_plugin_fails_with_one_line(
    make: Any, error: type[Exception], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay_out(tmp_path)
    document = {**SCENE, "renderer": {"name": "foreign"}, "optimise": {"positions": {}}}
    (tmp_path / "scene.toml").write_text(to_toml(document))
    monkeypatch.setattr("loi_core.scenes.renderers.load_renderer", lambda name: lambda: make())
    with pytest.raises(error, match=message):
        Start.of(load_scene(tmp_path / "scene.toml"))

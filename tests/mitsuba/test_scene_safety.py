"""A Mitsuba scene from a stranger loads no plugin but Mitsuba's own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import OptionError
from loi_core.io.images import write_png
from loi_mitsuba import MitsubaRenderer, SceneLoadError, Translate
from mitsuba_boundaries.scene_checks import LIBRARY_SUFFIXES

FILM = '<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>'
BALL = '<shape type="sphere" id="ball"/>'
LIGHT = '<emitter type="constant"/>'
EVIL = '<emitter type="evil"/>'
SUFFIX = next(path.suffix for path in (Path(mi.__file__).parent / "plugins").iterdir() if path.stem == "sphere")

assert SUFFIX in LIBRARY_SUFFIXES


def write_scene(folder: Path, body: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0"><sensor type="perspective">{FILM}</sensor>{body}</scene>')
    return path


def write_library(folder: Path, name: str) -> None:
    """Write a file that Mitsuba takes for a plugin; it is not a library, so that loading it fails."""
    (folder / "plugins").mkdir(exist_ok=True, parents=True)
    (folder / "plugins" / f"{name}{SUFFIX}").write_bytes(b"not a library")


def load(scene: Any, **options: Any) -> MitsubaRenderer:
    return MitsubaRenderer(scene, {"place": Translate("ball")}, spp=1, **options)


def test_a_plugin_beside_the_scene_is_not_loaded(tmp_path: Path) -> None:
    write_library(tmp_path, "evil")
    with pytest.raises(SceneLoadError, match="'evil' is not Mitsuba's own"):
        load(write_scene(tmp_path, BALL + EVIL))


def test_a_plugin_in_the_current_folder_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_library(tmp_path, "evil")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneLoadError, match="not Mitsuba's own"):
        load({"type": "scene", "light": {"type": "evil"}})


@pytest.mark.parametrize("path_element", [True, False], ids=["path element", "include"])
def test_a_plugin_in_another_folder_of_the_scene_is_not_loaded(tmp_path: Path, *, path_element: bool) -> None:
    write_library(tmp_path / "parts", "evil")
    (tmp_path / "parts" / "light.xml").write_text(f'<scene version="3.0.0">{EVIL}</scene>')
    body = f'<path value="parts"/>{EVIL}' if path_element else '<include filename="parts/light.xml"/>'
    with pytest.raises(SceneLoadError, match="not Mitsuba's own"):
        load(write_scene(tmp_path, BALL + body))


@pytest.mark.parametrize(
    "body",
    [
        '<include filename="pipe.xml"/>',
        "<default name='file' value='p&#105;pe.xml'/><include filename='$file'/>",
        '<include filename="light.xml"/>',
        '<texture type="bitmap"><string name="filename" value="pipe.xml"/></texture>',
    ],
    ids=["include", "parameter", "include of an include", "texture"],
)
def test_a_pipe_that_a_scene_names_is_refused_and_not_read(tmp_path: Path, body: str) -> None:
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "light.xml").write_text('<scene version="3.0.0"><include filename="pipe.xml"/></scene>')
    with pytest.raises(SceneLoadError, match=r"pipe\.xml: not a regular file"):
        load(write_scene(tmp_path, BALL + body))


def test_a_pipe_in_a_dict_is_refused_and_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(SceneLoadError, match=r"pipe\.png: not a regular file"):
        load({"type": "scene", "map": {"type": "bitmap", "filename": str(tmp_path / "pipe.png")}})


def test_entities_of_an_xml_scene_stay_unexpanded(tmp_path: Path) -> None:
    path = write_scene(tmp_path, f'{BALL}{LIGHT}<shape type="&s;"/>')
    path.write_text(f'<!DOCTYPE scene [<!ENTITY s "sphere">]>{path.read_text()}')
    with pytest.raises(SceneLoadError, match="got '&s;'"):
        load(path)


PROGRAM = """
import sys
import loi_mitsuba
renderer = loi_mitsuba.MitsubaRenderer(sys.argv[1], {"place": loi_mitsuba.Translate("ball")}, spp=1)
print(renderer.render(renderer.parameters()).shape)
"""


def test_libraries_with_the_names_of_mitsuba_s_plugins_do_not_replace_them(tmp_path: Path) -> None:
    """The test runs in a new process, where none of Mitsuba's plugins has been loaded."""
    for path in (Path(mi.__file__).parent / "plugins").iterdir():
        write_library(tmp_path, path.stem)
    bsdf = '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="thindielectric"/></bsdf>'
    colour = '<bsdf type="diffuse"><rgb name="reflectance" value="1 0 0"/></bsdf>'
    fog = '<medium name="interior" type="homogeneous"><rgb name="albedo" value="0.5"/></medium>'
    body = f'<shape type="sphere" id="ball">{bsdf}</shape><shape type="cube">{colour}{fog}</shape>{LIGHT}'
    scene = write_scene(tmp_path, body)
    completed = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, str(scene)], capture_output=True, text=True, cwd=tmp_path
    )
    assert completed.stdout.strip() == "(8, 8, 3)", completed.stderr


def test_loading_a_scene_leaves_mitsuba_s_search_path_unchanged(tmp_path: Path) -> None:
    resolver = mi.file_resolver()
    search_path = [str(resolver[index]) for index in range(len(resolver))]
    load(write_scene(tmp_path, f'<path value="{tmp_path}"/>{BALL}{LIGHT}'))
    resolver = mi.file_resolver()
    assert [str(resolver[index]) for index in range(len(resolver))] == search_path


@pytest.mark.parametrize("name", ["../../x/evil", "/x/evil", "a.b", "", "evil\n"])
def test_a_plugin_s_name_is_not_a_path(name: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="`integrator` cannot be loaded: a plugin's name must be"):
        load(write_scene(tmp_path, BALL + LIGHT), integrator={"type": name})


def test_an_integrator_s_table_in_a_scene_file_names_no_path(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path, BALL + LIGHT)
    write_png(tmp_path / "target.png", np.zeros((8, 8, 3)))
    (tmp_path / "scene.toml").write_text(
        'target = "target.png"\n[renderer]\nname = "mitsuba"\nscene = "scene.xml"\n'
        'parameters = { place = { Translate = "ball" } }\nintegrator = { type = "../../x/evil" }\n[optimise.place]\n'
    )
    assert main(["fit", str(tmp_path / "scene.toml")]) == 2
    assert "a plugin's name must be" in capsys.readouterr().err


@pytest.mark.parametrize("body", ["<", '<include filename="scene.xml"/>'], ids=["no XML", "an endless include"])
def test_a_scene_that_mitsuba_cannot_parse_is_an_error_in_one_line(body: str, tmp_path: Path) -> None:
    with pytest.raises(SceneLoadError, match=r"cannot be loaded: .*scene\.xml") as caught:
        load(write_scene(tmp_path, body))
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_scene_that_is_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(SceneLoadError, match="not a regular file"):
        load(tmp_path / "pipe")


def test_a_spectrum_may_lie_beside_its_scene(tmp_path: Path) -> None:
    (tmp_path / "white.spd").write_text("400 1\n700 1\n")
    light = '<emitter type="constant"><spectrum name="radiance" filename="white.spd"/></emitter>'
    load(write_scene(tmp_path, BALL + light))


def test_a_scene_includes_files_of_its_subfolders(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "light.xml").write_text(f'<scene version="3.0.0">{LIGHT}</scene>')
    load(write_scene(tmp_path, BALL + '<include filename="parts/light.xml"/>'))

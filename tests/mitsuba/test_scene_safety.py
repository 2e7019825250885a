"""A Mitsuba scene from a stranger runs no code of its own, and takes down no process but the one that tries it."""

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
from loi_mitsuba.scene import safety
from loi_mitsuba.scene.safety import LIBRARY_SUFFIXES

FILM = '<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>'
BALL = '<shape type="sphere" id="ball"/>'
LIGHT = '<emitter type="constant"/>'
SUFFIX = next(path.suffix for path in (Path(mi.__file__).parent / "plugins").iterdir() if path.stem == "sphere")

assert SUFFIX in LIBRARY_SUFFIXES


def written(folder: Path, body: str, name: str = "scene.xml") -> Path:
    path = folder / name
    path.write_text(f'<scene version="3.0.0"><sensor type="perspective">{FILM}</sensor>{body}</scene>')
    return path


def loaded(scene: Any, **options: Any) -> MitsubaRenderer:
    return MitsubaRenderer(scene, {"place": Translate("ball")}, spp=1, **options)


def library(folder: Path, name: str) -> None:
    """What Mitsuba would take for a plugin; it is not one, so to load it fails."""
    (folder / "plugins").mkdir(exist_ok=True)
    (folder / "plugins" / f"{name}{SUFFIX}").write_bytes(b"not a library")


def test_a_plugin_beside_the_scene_is_not_loaded(tmp_path: Path) -> None:
    library(tmp_path, "evil")
    with pytest.raises(SceneLoadError, match="'evil' is not Mitsuba's own"):
        loaded(written(tmp_path, BALL + '<emitter type="evil"/>'))


def test_a_plugin_in_the_folder_of_the_process_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library(tmp_path, "evil")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneLoadError, match="not Mitsuba's own"):
        loaded({"type": "scene", "light": {"type": "evil"}})


LOADS = """
import sys
import loi_mitsuba
renderer = loi_mitsuba.MitsubaRenderer(sys.argv[1], {"place": loi_mitsuba.Translate("ball")}, spp=1)
print(renderer.render(renderer.parameters()).shape)
"""


def test_libraries_that_have_the_names_of_plugins_of_mitsuba_do_not_stand_in_for_them(tmp_path: Path) -> None:
    """In a process of its own, in which none of them has been loaded yet."""
    for path in (Path(mi.__file__).parent / "plugins").iterdir():
        library(tmp_path, path.stem)
    bsdf = '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="thindielectric"/></bsdf>'
    colour = '<bsdf type="diffuse"><rgb name="reflectance" value="1 0 0"/></bsdf>'
    fog = '<medium name="interior" type="homogeneous"><rgb name="albedo" value="0.5"/></medium>'
    body = f'<shape type="sphere" id="ball">{bsdf}</shape><shape type="cube">{colour}{fog}</shape>{LIGHT}'
    scene = written(tmp_path, body)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", LOADS, str(scene)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stdout.strip() == "(8, 8, 3)", done.stderr


def test_a_scene_adds_no_folder_to_those_that_mitsuba_looks_in(tmp_path: Path) -> None:
    resolver = mi.file_resolver()
    before = [str(resolver[index]) for index in range(len(resolver))]
    with pytest.raises(SceneLoadError, match="<path> is not read"):
        loaded(written(tmp_path, f'<path value="{tmp_path}"/>{BALL}'))
    loaded(written(tmp_path, BALL + LIGHT))
    resolver = mi.file_resolver()
    assert [str(resolver[index]) for index in range(len(resolver))] == before


@pytest.mark.parametrize("name", ["../../x/evil", "/x/evil", "a.b", "", "evil\n"])
def test_a_plugin_is_not_a_path(name: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="`integrator` cannot be loaded: a plugin's name must be"):
        loaded(written(tmp_path, BALL + LIGHT), integrator={"type": name})


def test_a_table_of_a_scene_file_names_no_path_either(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path, BALL + LIGHT)
    write_png(tmp_path / "target.png", np.zeros((8, 8, 3)))
    (tmp_path / "scene.toml").write_text(
        'target = "target.png"\n[renderer]\nname = "mitsuba"\nscene = "scene.xml"\n'
        'parameters = { place = { Translate = "ball" } }\nintegrator = { type = "../../x/evil" }\n[optimise.place]\n'
    )
    assert main(["fit", str(tmp_path / "scene.toml")]) == 2
    assert "a plugin's name must be" in capsys.readouterr().err


BOMBS = {
    "parameters that double": '<default name="a0" value="xxxxxxxx"/>'
    + "".join(f'<default name="a{i + 1}" value="{f"$a{i}" * 8}"/>' for i in range(12)),
    "parameters with names that are no words": '<default name="a-0" value="x"/>',
    "elements within elements": '<shape type="sphere">' * 1000 + "</shape>" * 1000,
    "a scene that includes itself": '<include filename="scene.xml"/>',
    "an include that is chosen": '<default name="f" value="scene.xml"/><include filename="$f"/>',
    "no XML": "<",
}


@pytest.mark.parametrize("body", BOMBS.values(), ids=BOMBS)
def test_what_grows_without_bound_is_refused(body: str, tmp_path: Path) -> None:
    with pytest.raises(SceneLoadError, match=r"cannot be loaded: .*scene\.xml"):
        loaded(written(tmp_path, body))


def test_entities_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text('<!DOCTYPE scene [<!ENTITY a "aaaa">]><scene version="3.0.0"/>')
    with pytest.raises(SceneLoadError, match="document type"):
        loaded(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(SceneLoadError, match="not a regular file"):
        loaded(tmp_path / "pipe")
    mesh = '<shape type="ply"><string name="filename" value="pipe"/></shape>'
    with pytest.raises(SceneLoadError, match="pipe is not a regular file"):
        loaded(written(tmp_path, BALL + mesh))
    spectrum = '<emitter type="constant"><spectrum name="radiance" filename="pipe"/></emitter>'
    with pytest.raises(SceneLoadError, match="pipe is not a regular file"):
        loaded(written(tmp_path, BALL + spectrum))
    with pytest.raises(SceneLoadError, match="pipe is not a regular file"):
        loaded({"type": "scene", "mesh": {"type": "ply", "filename": str(tmp_path / "pipe")}})


def test_a_spectrum_may_lie_beside_its_scene(tmp_path: Path) -> None:
    (tmp_path / "white.spd").write_text("400 1\n700 1\n")
    loaded(
        written(tmp_path, BALL + '<emitter type="constant"><spectrum name="radiance" filename="white.spd"/></emitter>')
    )


def mesh(path: Path, face: list[int]) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + corners.tobytes() + b"\x03" + np.array(face, np.int32).tobytes())


@pytest.mark.parametrize("last", [3, 123456789])
def test_a_mesh_without_the_vertices_that_it_refers_to_is_refused(last: int, tmp_path: Path) -> None:
    scene = written(tmp_path, BALL + LIGHT + '<shape type="ply"><string name="filename" value="m.ply"/></shape>')
    mesh(tmp_path / "m.ply", [0, 1, last])
    with pytest.raises(SceneLoadError, match=r"makes Mitsuba crash|refers to vertex"):
        loaded(scene)
    table = {"type": "scene", "mesh": {"type": "ply", "filename": str(tmp_path / "m.ply")}}
    with pytest.raises(SceneLoadError, match=r"makes Mitsuba crash|refers to vertex"):
        loaded(table)
    mesh(tmp_path / "m.ply", [0, 1, 2])
    loaded(scene)


def test_what_goes_to_a_gpu_is_tried_on_the_processor(tmp_path: Path) -> None:
    """CUDA reserves more addresses than the process may have that tries it; here there need not be any GPU."""
    scene = written(tmp_path, BALL + LIGHT + '<shape type="ply"><string name="filename" value="m.ply"/></shape>')
    mesh(tmp_path / "m.ply", [0, 1, 2])
    safety._try_to_load("cuda_ad_rgb", str(scene), "")
    mesh(tmp_path / "m.ply", [0, 1, 3])
    with pytest.raises(SceneLoadError, match=r"makes Mitsuba crash|refers to vertex"):
        safety._try_to_load("cuda_ad_rgb", str(scene), "")


def test_a_scene_is_tried_again_only_where_one_of_its_files_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []
    before = safety._try_to_load

    def count(variant: str, path: str, description: str) -> None:
        tried.append(path)
        before(variant, path, description)

    monkeypatch.setattr(safety, "_try_to_load", count)
    scene = written(tmp_path, BALL + LIGHT + '<shape type="ply"><string name="filename" value="m.ply"/></shape>')
    mesh(tmp_path / "m.ply", [0, 1, 2])
    for _ in range(3):
        loaded(scene)
    assert len(tried) == 1
    written(tmp_path, BALL + LIGHT + '<shape type="ply"><string name="filename" value="./m.ply"/></shape>')
    loaded(scene)
    assert len(tried) == 2
    mesh(tmp_path / "m.ply", [0, 1, 3])
    for count_now in (3, 4):  # what is refused is not kept
        with pytest.raises(SceneLoadError, match=r"makes Mitsuba crash|refers to vertex"):
            loaded(scene)
        assert len(tried) == count_now


def test_files_of_a_scene_may_lie_in_its_folder_and_in_those_of_what_it_includes(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "light.xml").write_text(f'<scene version="3.0.0">{LIGHT}</scene>')
    loaded(written(tmp_path, BALL + '<include filename="parts/light.xml"/>'))

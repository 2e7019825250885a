"""A name means one object, however the scene was loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from loi_core.errors import OptionError, ParameterError
from loi_mitsuba import MitsubaRenderer, SceneLoadError, Translate, list_parameters

pytestmark = pytest.mark.filterwarnings("ignore::loi_mitsuba.GradientWarning")  # cubes have split vertices

DIFFUSE = '<bsdf type="diffuse"><rgb name="reflectance" value="{}"/></bsdf>'


def shape(kind: str, at: tuple[float, float, float], colour: str = "0.5", inside: str = "") -> str:
    """A shape without an id; those of one colour may be merged."""
    x, y, z = at
    place = f'<transform name="to_world"><scale value="0.3"/><translate x="{x}" y="{y}" z="{z}"/></transform>'
    return f'<shape type="{kind}">{inside}{place}{DIFFUSE.format(colour)}</shape>'


def write_scene(folder: Path, *shapes: str) -> Path:
    """A scene file with a camera and some shapes."""
    path = folder / "scene.xml"
    camera = '<sensor type="perspective"><float name="far_clip" value="100"/></sensor>'
    path.write_text(f'<scene version="3.0.0">{camera}{"".join(shapes)}<emitter type="constant"/></scene>')
    return path


def mesh_file(folder: Path, name: str, radius: float) -> str:
    """A PLY file, as what goes into the shape that reads it."""
    ball = mi.load_dict({"type": "cube", "to_world": mi.ScalarTransform4f().scale(radius)})
    ball.write_ply(str(folder / name))
    return f'<string name="filename" value="{name}"/>'


def places(scene: Any) -> dict[str, tuple[float, ...]]:
    """By name, where the shapes stand that can be moved by it."""
    found: dict[str, tuple[float, ...]] = {}
    for name, entry in list_parameters(scene).items():
        folder, _, last = name.rpartition(".")
        if last in ("vertex_positions", "to_world") and not entry.problem:
            renderer = MitsubaRenderer(scene, {"place": Translate(folder)})
            (moving,) = renderer._binding.moving()
            found[folder] = tuple(np.round(np.array(moving.bbox().center(), dtype=float).reshape(3), 4).tolist())
    return found


def test_a_name_means_the_same_mesh_in_a_file_and_in_a_scene_loaded_from_it(tmp_path: Path) -> None:
    path = write_scene(
        tmp_path,
        shape("ply", (1, 0, 0), "0.1", mesh_file(tmp_path, "plane.ply", 1.0)),
        shape("ply", (2, 0, 0), "0.2", mesh_file(tmp_path, "ball.ply", 0.5)),
        shape("sphere", (3, 0, 0)),
        shape("rectangle", (4, 0, 0), "0.3"),
        shape("rectangle", (5, 0, 0), "0.4"),
        shape("ply", (6, 0, 0), "0.6", mesh_file(tmp_path, "cone.ply", 0.2)),
        shape("cube", (7, 0, 0), "0.7"),
    )
    own = places(path)
    assert own["ply_mesh_0"] == (1, 0, 0)
    assert own["ply_mesh_2"] == (6, 0, 0)
    assert own["rectangle_1"] == (5, 0, 0)
    loaded = places(mi.load_file(str(path)))
    assert set(loaded.values()) == set(own.values())
    for name, place in loaded.items():  # the loaded scene's names, given to a renderer of the file
        renderer = MitsubaRenderer(path, {"place": Translate(name)})
        (moving,) = renderer._binding.moving()
        assert tuple(np.round(np.array(moving.bbox().center()).reshape(3), 4)) == pytest.approx(place), name
    assert all(own[name] == place for name, place in loaded.items() if name in own)


def test_merged_meshes_take_no_name_from_others(tmp_path: Path) -> None:
    alike = [shape("rectangle", (x, 0, 0)) for x in (1, 2)]
    path = write_scene(tmp_path, *alike, shape("rectangle", (3, 0, 0), "0.1"), shape("cube", (4, 0, 0), "0.2"))
    loaded = mi.load_file(str(path))
    assert places(path)["rectangle_0"] == (1, 0, 0)
    assert places(loaded) == {"rectangle_at_3_0_0": (3, 0, 0), "cube_at_4_0_0": (4, 0, 0)}
    with pytest.raises(ParameterError, match="no shape 'rectangle_0'"):
        MitsubaRenderer(loaded, {"place": Translate("rectangle_0")})
    with pytest.raises(
        ParameterError, match=r"'merged_meshes' cannot be moved: .*merged several meshes.*give the renderer the path"
    ):
        MitsubaRenderer(loaded, {"place": Translate("merged_meshes")})
    with pytest.raises(ParameterError, match="merged several meshes"):
        MitsubaRenderer(loaded, {"colour": "merged_meshes.bsdf.reflectance.value"})


def test_meshes_in_one_place_are_told_apart_by_their_size(tmp_path: Path) -> None:
    inside = [
        shape("cube", (0, 3, 0), f"0.{k}").replace('<scale value="0.3"/>', f'<scale value="{k}"/>') for k in range(1, 6)
    ]
    path = write_scene(tmp_path, *inside)
    for scene in (path, mi.load_file(str(path))):
        for k in range(1, 6):
            renderer = MitsubaRenderer(scene, {"place": Translate(f"cube_at_0_3_0_size_{2 * k}_{2 * k}_{2 * k}")})
            (moving,) = renderer._binding.moving()
            np.testing.assert_allclose(np.array(moving.bbox().max)[0], k)


def test_entries_of_meshes_go_by_both_names(tmp_path: Path) -> None:
    path = write_scene(tmp_path, shape("rectangle", (1, 0, 0), "0.1"), shape("rectangle", (2, 0, 0), "0.9"))
    for scene, names in (
        (path, ("rectangle_1", "rectangle_at_2_0_0")),
        (mi.load_file(str(path)), ("rectangle_at_2_0_0",)),
    ):
        for name in names:
            colour = MitsubaRenderer(scene, {"colour": f"{name}.bsdf.reflectance.value"}).parameters()["colour"]
            np.testing.assert_allclose(colour, 0.9, rtol=1e-6)


def test_entries_are_listed_of_files_dicts_and_scenes(tmp_path: Path) -> None:
    path = write_scene(tmp_path, shape("sphere", (0, 0, 0)))
    assert (
        list(list_parameters(path))
        == list(list_parameters(str(path)))
        == list(list_parameters(mi.load_file(str(path))))
    )
    assert "ball.to_world" in list_parameters({"type": "scene", "ball": {"type": "sphere"}})
    with pytest.raises(SceneLoadError, match=r"none\.xml"):
        list_parameters(tmp_path / "none.xml")
    with pytest.raises(OptionError, match=r"`scene` must be a dict, the path of an XML file, or an mi\.Scene"):
        list_parameters(3)


def test_what_is_not_set_has_no_name() -> None:
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "hair"}}}
    names = list_parameters(scene)
    assert "ball.bsdf.eumelanin" in names
    assert not any("sigma_a" in name for name in names)

"""A name refers to the same object however the scene was loaded."""

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


def shape(plugin: str, position: tuple[float, float, float], colour: str = "0.5", inside: str = "") -> str:
    """Return a shape without an id; Mitsuba may merge shapes of one colour."""
    x, y, z = position
    transform = f'<transform name="to_world"><scale value="0.3"/><translate x="{x}" y="{y}" z="{z}"/></transform>'
    return f'<shape type="{plugin}">{inside}{transform}{DIFFUSE.format(colour)}</shape>'


def write_scene(folder: Path, *shapes: str) -> Path:
    """Write a scene file with a camera and some shapes."""
    path = folder / "scene.xml"
    camera = '<sensor type="perspective"><float name="far_clip" value="100"/></sensor>'
    path.write_text(f'<scene version="3.0.0">{camera}{"".join(shapes)}<emitter type="constant"/></scene>')
    return path


def mesh_file(folder: Path, name: str, radius: float) -> str:
    """Write a PLY file, and return the XML that names it in a shape."""
    ball = mi.load_dict({"type": "cube", "to_world": mi.ScalarTransform4f().scale(radius)})
    ball.write_ply(str(folder / name))
    return f'<string name="filename" value="{name}"/>'


def places(scene: Any) -> dict[str, tuple[float, ...]]:
    """Return the position of each shape that can be moved, by name."""
    positions: dict[str, tuple[float, ...]] = {}
    for name, entry in list_parameters(scene).items():
        folder, _, last = name.rpartition(".")
        if last in ("vertex_positions", "to_world") and not entry.problem:
            renderer = MitsubaRenderer(scene, {"place": Translate(folder)})
            (moving,) = renderer._binding.moving()
            positions[folder] = tuple(np.round(np.array(moving.bbox().center(), dtype=float).reshape(3), 4).tolist())
    return positions


def test_a_name_refers_to_the_same_mesh_in_a_file_and_in_its_loaded_scene(tmp_path: Path) -> None:
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
    file_positions = places(path)
    assert file_positions["ply_mesh_0"] == (1, 0, 0)
    assert file_positions["ply_mesh_2"] == (6, 0, 0)
    assert file_positions["rectangle_1"] == (5, 0, 0)
    loaded = places(mi.load_file(str(path)))
    assert set(loaded.values()) == set(file_positions.values())
    for name, position in loaded.items():  # a renderer of the file accepts the names of the loaded scene
        renderer = MitsubaRenderer(path, {"place": Translate(name)})
        (moving,) = renderer._binding.moving()
        assert tuple(np.round(np.array(moving.bbox().center()).reshape(3), 4)) == pytest.approx(position), name
    assert all(file_positions[name] == position for name, position in loaded.items() if name in file_positions)


def test_merged_meshes_do_not_take_the_names_of_other_meshes(tmp_path: Path) -> None:
    mergeable = [shape("rectangle", (x, 0, 0)) for x in (1, 2)]
    path = write_scene(tmp_path, *mergeable, shape("rectangle", (3, 0, 0), "0.1"), shape("cube", (4, 0, 0), "0.2"))
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


def test_meshes_in_one_position_are_named_by_their_size(tmp_path: Path) -> None:
    nested = [
        shape("cube", (0, 3, 0), f"0.{k}").replace('<scale value="0.3"/>', f'<scale value="{k}"/>') for k in range(1, 6)
    ]
    path = write_scene(tmp_path, *nested)
    for scene in (path, mi.load_file(str(path))):
        for k in range(1, 6):
            renderer = MitsubaRenderer(scene, {"place": Translate(f"cube_at_0_3_0_size_{2 * k}_{2 * k}_{2 * k}")})
            (moving,) = renderer._binding.moving()
            np.testing.assert_allclose(np.array(moving.bbox().max)[0], k)


def test_entries_of_meshes_have_both_names(tmp_path: Path) -> None:
    path = write_scene(tmp_path, shape("rectangle", (1, 0, 0), "0.1"), shape("rectangle", (2, 0, 0), "0.9"))
    for scene, names in (
        (path, ("rectangle_1", "rectangle_at_2_0_0")),
        (mi.load_file(str(path)), ("rectangle_at_2_0_0",)),
    ):
        for name in names:
            colour = MitsubaRenderer(scene, {"colour": f"{name}.bsdf.reflectance.value"}).parameters()["colour"]
            np.testing.assert_allclose(colour, 0.9, rtol=1e-6)


def test_parameters_of_files_dicts_and_scenes_are_listed(tmp_path: Path) -> None:
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


def test_a_parameter_that_is_not_set_is_not_listed() -> None:
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "hair"}}}
    names = list_parameters(scene)
    assert "ball.bsdf.eumelanin" in names
    assert not any("sigma_a" in name for name in names)

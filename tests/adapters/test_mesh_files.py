"""Tests of meshes from files and in scene files: formats, colours, textures, and files that are not opened."""

from __future__ import annotations

import json
import os
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from loi_core import Free, LOIObjective, fit
from loi_core.cli import main
from loi_core.errors import MeshError
from loi_core.io.images import write_png
from loi_core.pixels.encoding import decode_srgb, encode_srgb
from loi_torch.mesh import (
    Camera,
    Light,
    MeshRenderer,
    MeshWarning,
    Translate,
    box,
    draw,
    read_cameras,
    read_mesh,
    read_meshes,
)

TRIANGLES = trimesh.creation.box((1.0, 2.0, 3.0))


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "off"])
def test_mesh_formats_give_the_same_triangles(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"box.{suffix}"
    TRIANGLES.export(path)
    mesh = read_mesh(path, colours=(0.2, 0.4, 0.6))
    camera = Camera((3.0, 2.0, 5.0))
    expected = draw([box((1.0, 2.0, 3.0), colours=(0.2, 0.4, 0.6))], camera, 24, 24)
    np.testing.assert_allclose(draw([mesh], camera, 24, 24).numpy(), expected.numpy(), atol=1e-5)
    assert not mesh.topology.discontinuous.any()  # the separate corners of an STL are welded


def test_vertex_colours_of_a_file_are_decoded(tmp_path: Path) -> None:
    coloured = trimesh.Trimesh(TRIANGLES.vertices, TRIANGLES.faces, vertex_colors=np.full((8, 4), 128, np.uint8))
    coloured.export(tmp_path / "box.ply")
    np.testing.assert_allclose(read_mesh(tmp_path / "box.ply").colours.numpy(), 0.2158605, atol=1e-6)


def test_a_mesh_has_the_texture_of_its_glb(tmp_path: Path) -> None:
    from PIL import Image

    picture = Image.fromarray(np.full((4, 4, 3), 255, np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)  # type: ignore[no-untyped-call]
    uv = np.random.default_rng(0).uniform(size=(8, 2))
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)  # type: ignore[no-untyped-call]
    trimesh.Trimesh(TRIANGLES.vertices, TRIANGLES.faces, visual=visual, process=False).export(tmp_path / "box.glb")
    mesh = read_mesh(tmp_path / "box.glb")
    np.testing.assert_allclose(mesh.texture.numpy(), 1.0)
    np.testing.assert_allclose(np.sort(mesh.uv.numpy(), axis=0), np.sort(uv, axis=0), atol=1e-6)


def test_an_stl_has_as_many_vertices_as_a_ply(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    for suffix in ("ply", "stl"):
        ball.export(tmp_path / f"ball.{suffix}")
    assert len(read_mesh(tmp_path / "ball.stl").vertices) == len(read_mesh(tmp_path / "ball.ply").vertices)


def test_triangle_colours_of_a_file_are_decoded(tmp_path: Path) -> None:
    coloured = TRIANGLES.copy()
    colours = np.tile([255, 128, 0, 255], (12, 1)).astype(np.uint8)
    coloured.visual = trimesh.visual.ColorVisuals(coloured, face_colors=colours)
    coloured.export(tmp_path / "box.ply")
    mesh = read_mesh(tmp_path / "box.ply")
    assert mesh.per == "triangle"
    np.testing.assert_allclose(mesh.colours.numpy(), np.tile([1.0, 0.2158605, 0.0], (12, 1)), atol=1e-6)


def write_glb(path: Path, *materials: Any) -> Path:
    """Write boxes side by side, one for each material."""
    scene = trimesh.Scene()
    for number, material in enumerate(materials):
        geometry = TRIANGLES.copy()
        geometry.apply_translation([3.0 * number, 0.0, 0.0])
        geometry.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=material)  # type: ignore[no-untyped-call]
        scene.add_geometry(geometry)
    scene.export(path)  # type: ignore[no-untyped-call]
    return path


def glb_material(**options: Any) -> Any:
    return trimesh.visual.material.PBRMaterial(**options)  # type: ignore[no-untyped-call]


def test_a_mesh_has_the_linear_base_colours_of_its_glb(tmp_path: Path) -> None:
    red, grey = glb_material(baseColorFactor=[255, 0, 0, 255]), glb_material(baseColorFactor=[128, 128, 128, 255])
    red_mesh = read_mesh(write_glb(tmp_path / "one.glb", red))
    np.testing.assert_allclose(red_mesh.colours.numpy(), [1.0, 0.0, 0.0])
    merged = read_mesh(write_glb(tmp_path / "two.glb", red, grey))
    np.testing.assert_allclose(np.unique(merged.colours.numpy(), axis=0), [[128 / 255] * 3, [1.0, 0.0, 0.0]], atol=1e-6)


def test_several_textures_of_a_file_give_a_warning(tmp_path: Path) -> None:
    from PIL import Image

    picture = Image.fromarray(np.full((4, 4, 3), 255, np.uint8))
    path = write_glb(
        tmp_path / "two.glb", glb_material(baseColorTexture=picture), glb_material(baseColorTexture=picture)
    )
    with pytest.warns(MeshWarning, match=r"two\.glb: has 2 parts with separate textures"):
        read_mesh(path)
    read_mesh(path, colours=(1.0, 0.0, 0.0))  # explicit colours: no warning


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"", "has no triangles|cannot be read"),
        ("a.stl", b"solid\nnothing", "has no triangles|cannot be read"),
        ("a.ply", b"\x00" * 100, "cannot be read as a mesh"),
        ("a.glb", b"glTF" + b"\xff" * 60, "cannot be read as a mesh"),
        ("a.blend", b"", "a mesh must be one of .obj"),
    ],
)
def test_files_that_are_not_meshes_are_refused(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=message):
        read_mesh(tmp_path / name)


def test_missing_and_special_mesh_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="No such file"):
        read_mesh(tmp_path / "gone.obj")
    os.mkfifo(tmp_path / "pipe.obj")
    with pytest.raises(MeshError, match="not a regular file"):
        read_mesh(tmp_path / "pipe.obj")


def test_reading_a_mesh_opens_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An OBJ names a file of materials, and a glTF names a file of data."""
    opened: list[str] = []
    path_open = Path.open

    def recording_open(path: Path, *args: Any, **options: Any) -> Any:
        opened.append(path.name)
        return path_open(path, *args, **options)

    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd /etc/passwd\n")
    lines = ["mtllib secret.mtl", "usemtl a", "v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 3"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    data = {"asset": {"version": "2.0"}, "buffers": [{"uri": "secret.bin", "byteLength": 4}], "meshes": []}
    (tmp_path / "secret.bin").write_bytes(b"\x00" * 4)
    (tmp_path / "a.gltf").write_text(json.dumps(data))
    monkeypatch.setattr(Path, "open", recording_open)
    with pytest.warns(MeshWarning, match=r"names files that were not read: 'secret.mtl'; side_files=True opens them"):
        assert len(read_mesh(tmp_path / "a.obj").faces) == 1
    assert len(read_mesh(tmp_path / "a.obj", colours=(1.0, 0.0, 0.0)).faces) == 1  # nothing is lacking: no warning
    with pytest.raises(MeshError):
        read_mesh(tmp_path / "a.gltf")
    assert not [name for name in opened if name.startswith("secret")]


OBJ = """
mtllib crate.mtl
o Crate.001
v 0 0 0
v 1 0 0
v 0 1 0
v 1 1 0
vt 0 0
vt 1 0
vt 0 1
usemtl red
f 1 2 3
usemtl painted
f 2/1 4/2 3/3
o Ball
v 0 0 2
v 1 0 2
v 0 1 2
usemtl red
f 5 6 7
"""


def write_obj(folder: Path) -> Path:
    """Write an OBJ of two objects, with materials and a texture in files beside it."""
    (folder / "crate.mtl").write_text("newmtl red\nKd 0.8 0.1 0.05\nnewmtl painted\nKd 1 0.5 1\nmap_Kd paint.png\n")
    write_png(folder / "paint.png", np.full((2, 2, 3), 0.5))
    (folder / "crate.obj").write_text(OBJ)
    return folder / "crate.obj"


def test_objects_of_an_obj_are_meshes_with_their_materials(tmp_path: Path) -> None:
    meshes = read_meshes(write_obj(tmp_path), side_files=True)
    assert sorted(meshes) == ["Ball", "Crate_001_painted", "Crate_001_red"]
    np.testing.assert_allclose(meshes["Ball"].colours.numpy(), [0.8, 0.1, 0.05])
    np.testing.assert_allclose(meshes["Ball"].vertices[:, 2].numpy(), 2.0)
    painted = meshes["Crate_001_painted"]
    np.testing.assert_allclose(painted.colours.numpy(), [1.0, 0.5, 1.0])
    np.testing.assert_allclose(painted.texture.numpy(), decode_srgb(np.full((2, 2, 3), 128 / 255)), atol=1e-12)
    merged = read_mesh(tmp_path / "crate.obj", colours=(0.5, 0.5, 0.5))
    assert len(merged.faces) == sum(len(mesh.faces) for mesh in meshes.values())
    renderer = MeshRenderer(8, 8, meshes, Camera((0, 0, 5)), {"position": Translate("Ball")})
    assert "Crate_001_red.colours" in renderer.entries()


def test_named_files_outside_the_folder_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    path = write_obj(tmp_path / "inside")
    (tmp_path / "crate.mtl").write_text("newmtl red\nKd 0.8 0.1 0.05\n")
    for name in ("../crate.mtl", "gone.mtl", "."):
        path.write_text(OBJ.replace("mtllib crate.mtl", f"mtllib {name}"))
        with pytest.warns(MeshWarning, match=f"names files that were not read: '{re.escape(name)}'$"):
            read_meshes(path, side_files=True)


def test_objects_of_a_glb_are_meshes_in_world_space(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for number, name in enumerate(("Crate", "Lid.001")):
        shift = trimesh.transformations.translation_matrix([3.0 * number, 0.0, 0.0])  # type: ignore[no-untyped-call]
        scene.add_geometry(TRIANGLES, node_name=name, geom_name=f"{name}-data", transform=shift)
    scene.export(tmp_path / "two.glb")  # type: ignore[no-untyped-call]
    meshes = read_meshes(tmp_path / "two.glb")
    assert sorted(meshes) == ["Crate", "Lid_001"]
    offset = meshes["Lid_001"].vertices.mean(dim=0) - meshes["Crate"].vertices.mean(dim=0)
    np.testing.assert_allclose(offset.numpy(), [3.0, 0.0, 0.0], atol=1e-6)
    scene.export(tmp_path / "two.gltf")  # type: ignore[no-untyped-call]
    assert sorted(read_meshes(tmp_path / "two.gltf", side_files=True)) == sorted(meshes)


GLTF_NODES: list[dict[str, Any]] = [
    {"name": "rig", "translation": [1.0, 2.0, 3.0], "rotation": [0.0, 2**-0.5, 0.0, 2**-0.5], "children": [1, 2]},
    {"name": "Camera.001", "camera": 0, "translation": [0.0, 0.0, 5.0], "scale": [2.0, 2.0, 2.0]},
    {"camera": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 7, 1]},
]
GLTF_CAMERAS: list[dict[str, Any]] = [
    {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}},
    {"type": "orthographic", "orthographic": {"xmag": 2.0, "ymag": 1.5, "znear": 0.2, "zfar": 9.0}},
]


@pytest.mark.parametrize("binary", [False, True])
def test_cameras_of_a_gltf_stand_where_its_nodes_put_them(binary: bool, tmp_path: Path) -> None:
    content = json.dumps({"asset": {"version": "2.0"}, "nodes": GLTF_NODES, "cameras": GLTF_CAMERAS}).encode()
    if binary:
        content = struct.pack("<4sIIII", b"glTF", 2, 20 + len(content), len(content), 0x4E4F534A) + content
    path = tmp_path / "cameras.glb"
    path.write_bytes(content)
    first, second = (cameras := read_cameras(path)).values()
    assert list(cameras) == ["Camera_001", "camera_1"]
    # A quarter turn about y takes z to x; a camera looks along its -z.
    np.testing.assert_allclose(first.position.numpy(), [6.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(first.axes().numpy(), [[0, 0, -1], [0, -1, 0], [-1, 0, 0]], atol=1e-12)
    assert float(first.fov) == pytest.approx(np.degrees(0.5))
    np.testing.assert_allclose(second.position.numpy(), [8.0, 2.0, 3.0], atol=1e-12)
    assert float(second.extent) == 3.0


def test_an_exported_scene_is_fitted_as_it_is(tmp_path: Path) -> None:
    """A glTF with its data beside it, named objects and a camera, as Blender exports a scene."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1.0, 1.0, 1.0)), node_name="Crate.001", geom_name="box")
    scene.export(tmp_path / "scene.gltf")  # type: ignore[no-untyped-call]
    document = json.loads((tmp_path / "scene.gltf").read_text())
    document["nodes"].append({"name": "Camera", "camera": 0, "translation": [0.0, 0.0, 6.0]})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    document["cameras"] = GLTF_CAMERAS[:1]
    (tmp_path / "scene.gltf").write_text(json.dumps(document))
    meshes, cameras = read_meshes(tmp_path / "scene.gltf", side_files=True), read_cameras(tmp_path / "scene.gltf")
    renderer = MeshRenderer(24, 32, meshes, cameras["Camera"], {"position": Translate("Crate_001")})
    goal = {"position": torch.tensor([0.5, -0.3, 0.0], dtype=torch.float64)}
    start = Free((-0.5, 0.3, 0.0), (-1.0, -1.0, -0.1), (1.0, 1.0, 0.1))
    result = fit(renderer, LOIObjective(renderer.render(goal)), steps=60, optimise={"position": start})
    pixel = 2.0 * 5.5 * np.tan(0.25) / 24  # in world units, at the front of the box
    assert (result.best_params["position"] - goal["position"]).abs().max() < pixel


@pytest.mark.parametrize(
    "document",
    [
        [],
        {"nodes": [{"camera": 3}], "cameras": []},
        {"nodes": [{"camera": 0, "children": [0]}], "cameras": GLTF_CAMERAS},
        {"nodes": [{"camera": 0, "matrix": [1]}], "cameras": GLTF_CAMERAS},
        {"nodes": [{"camera": 0, "scale": [0, 0, 0]}], "cameras": GLTF_CAMERAS},
        {"nodes": [{"camera": 0}], "cameras": [{"type": "perspective", "perspective": {"yfov": 9, "znear": 0.1}}]},
        {"nodes": [{"camera": 0}], "cameras": [{"type": "perspective", "perspective": {"yfov": "1", "znear": 0.1}}]},
    ],
)
def test_cameras_that_are_not_valid_are_refused(document: Any, tmp_path: Path) -> None:
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(MeshError, match=r"a\.gltf: its cameras cannot be read as glTF"):
        read_cameras(tmp_path / "a.gltf")


SCENE = """
target = "photo.png"
[renderer]
name = "mesh-torch"
meshes = { box = "models/box.obj" }
textures = {}
lights = { sun = { direction = [-1, -2, -3] } }
parameters = { position = { Translate = "box" } }
camera = { position = [0, 2, 8], target = [0, 0, 0], fov = 40 }
[optimise.position]
initial = [-1.5, 0.3, 0.0]
lower = [-3, -3, 0]
upper = [3, 3, 0]
[fit]
steps = 60
"""


def scene_renderer(folder: Path, **options: Any) -> MeshRenderer:
    """Return the renderer that the scene file describes."""
    return MeshRenderer(
        48,
        64,
        {"box": folder / "models" / "box.obj"},
        Camera((0, 2, 8), fov=40.0),
        {"position": Translate("box")},
        lights={"sun": Light(direction=(-1, -2, -3))},
        **options,
    )


def test_a_fit_of_a_scene_file_finds_the_position_of_a_mesh(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    TRIANGLES.export(tmp_path / "models" / "box.obj")
    (tmp_path / "scene.toml").write_text(SCENE)
    renderer = scene_renderer(tmp_path)
    position = torch.tensor([1.0, -0.4, 0.0], dtype=torch.float64)
    write_png(tmp_path / "photo.png", encode_srgb(renderer.render({"position": position}).numpy()))
    assert main(["fit", str(tmp_path / "scene.toml")]) in (0, 3)
    parameters = json.loads((tmp_path / "scene-result" / "parameters.json").read_text())
    best = parameters.get("best", parameters)["position"]
    assert np.ravel(best) == pytest.approx([1.0, -0.4, 0.0], abs=0.02)


@pytest.mark.parametrize("option", ["images", "path"])
def test_the_background_of_a_scene_file_is_decoded_as_the_target(option: str, tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    TRIANGLES.export(tmp_path / "models" / "box.obj")
    background = np.random.default_rng(5).uniform(size=(48, 64, 3))
    write_png(tmp_path / "background.png", encode_srgb(background))
    line = '[renderer.images]\nbackground = "background.png"\n[optimise.position]'
    scene = SCENE.replace("[optimise.position]", line)
    if option == "path":
        scene = SCENE.replace("textures = {}", 'background = "background.png"')
    scene = scene.replace("[-1.5, 0.3, 0.0]", "[1.0, -0.4, 0.0]").replace("steps = 60", "steps = 2")
    (tmp_path / "scene.toml").write_text(scene)
    renderer = scene_renderer(tmp_path, background=background)
    position = torch.tensor([1.0, -0.4, 0.0], dtype=torch.float64)
    write_png(tmp_path / "photo.png", encode_srgb(renderer.render({"position": position}).numpy()))
    main(["fit", str(tmp_path / "scene.toml")])
    result = json.loads((tmp_path / "scene-result" / "result.json").read_text())
    assert result["trials"][0]["psnr_initial"] > 50.0  # the start is the truth, up to 8 bits


def test_a_fit_of_a_scene_file_reports_a_missing_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    write_png(tmp_path / "photo.png", np.zeros((8, 8, 3)))
    assert main(["fit", str(tmp_path / "scene.toml")]) != 0
    assert "No such file or directory" in capsys.readouterr().err

"""The mesh rasteriser of loi_torch agrees with Mitsuba on one scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from loi_mitsuba import MitsubaRenderer, Translate  # before drjit and mitsuba

# isort: split
import drjit as dr
import mitsuba as mi
import torch

from loi_torch.mesh import Camera, Light, Material, box, draw, sphere
from tests.helpers import Host
from tests.strategies import thorough

SIZE_PX = 32
CAMERA_POSITION = (2.2, 1.5, 4.0)
COLOUR = [0.8, 0.4, 0.2]
OFFSET, STEP = 0.2, 0.02
SHAPES = {
    "box": (trimesh.creation.box((2.0, 2.0, 2.0)), box((2.0, 2.0, 2.0))),
    "ball": (trimesh.Trimesh(sphere().vertices.numpy(), sphere().faces, process=False), sphere()),
}


def mitsuba_scene(shape: str, folder: Path, offset: float = 0.0) -> Any:
    """A mesh file, because Mitsuba's own box is unwelded, and its gradient counts the silhouettes several times."""
    mi.set_variant("llvm_ad_rgb")
    SHAPES[shape][0].export(folder / "shape.ply")
    view = mi.ScalarTransform4f().look_at(list(CAMERA_POSITION), [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE_PX, "height": SIZE_PX, "filter": {"type": "box"}, "sample_border": True}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct_projective", "guiding": "none", "sppi": 0},
            "camera": {"type": "perspective", "fov": 45, "to_world": view, "film": film},
            "sun": {"type": "directional", "direction": [-1, -2, -3], "irradiance": {"type": "rgb", "value": np.pi}},
            "shape": {
                "type": "ply",
                "filename": str(folder / "shape.ply"),
                "face_normals": shape == "box",
                "to_world": mi.ScalarTransform4f().translate([offset, 0, 0]),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": COLOUR}},
            },
        }
    )


def rasterise(shape: str, offset: torch.Tensor) -> torch.Tensor:
    mesh = replace(SHAPES[shape][1], colours=COLOUR, material=Material(ambient=0.0, diffuse=1.0, specular=0.0))
    moved = replace(mesh, vertices=mesh.vertices + torch.stack([offset, 0.0 * offset, 0.0 * offset]))
    return draw([moved], Camera(CAMERA_POSITION), SIZE_PX, SIZE_PX, lights=[Light(direction=(-1.0, -2.0, -3.0))])


def weights() -> Host:
    coarse = np.random.default_rng(0).normal(size=(4, 4, 3))
    return np.repeat(np.repeat(coarse, SIZE_PX // 4, axis=0), SIZE_PX // 4, axis=1)


def slope(shape: str) -> float:
    leaf = torch.tensor(OFFSET, dtype=torch.float64, requires_grad=True)
    (rasterise(shape, leaf) * torch.from_numpy(weights())).sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    return float(leaf.grad)


def agrees(value: float, estimates: list[float], rtol: float) -> bool:
    """Return whether a value is within four standard errors, and `rtol` for shading at pixel centres, of the mean."""
    error = 4.0 * np.std(estimates, ddof=1) / np.sqrt(len(estimates))
    return bool(abs(value - np.mean(estimates)) < error + rtol * abs(np.mean(estimates)))


@pytest.mark.parametrize("shape", SHAPES)
def test_both_renderers_show_the_same_image_of_a_shape(shape: str, tmp_path: Path) -> None:
    image = np.array(mi.render(mitsuba_scene(shape, tmp_path, OFFSET), spp=1024))
    difference = np.abs(rasterise(shape, torch.tensor(OFFSET, dtype=torch.float64)).numpy() - image)
    assert difference.mean() < 2e-3
    assert difference.max() < 0.1  # where the ball turns away from the light within a pixel


def test_the_rasteriser_has_the_finite_difference_of_mitsuba_s_images_of_a_box(tmp_path: Path) -> None:
    scenes = [mitsuba_scene("box", tmp_path, OFFSET + sign * STEP) for sign in (1.0, -1.0)]
    estimates = []
    for seed in range(6):
        forward, backward = (np.array(mi.render(scene, spp=256, seed=seed), dtype=np.float64) for scene in scenes)
        estimates.append(float(np.sum((forward - backward) * weights())) / (2.0 * STEP))
    assert agrees(slope("box"), estimates, 0.005)


def test_both_renderers_have_the_same_gradient_of_a_box(tmp_path: Path) -> None:
    scene = mitsuba_scene("box", tmp_path)
    renderer = MitsubaRenderer(scene, {"x": Translate("shape", (1, 0, 0))}, integrator="scene", spp_grad=256)
    weight = weights().astype(np.float32)
    estimates = [float(renderer.vjp({"x": np.float32(OFFSET)}, weight, seed=seed)["x"]) for seed in range(8)]
    assert agrees(slope("box"), estimates, 0.03)


@thorough
def test_both_renderers_have_the_same_gradient_of_a_ball(tmp_path: Path) -> None:
    scene = mitsuba_scene("ball", tmp_path)
    params = mi.traverse(scene)
    start = dr.unravel(mi.Point3f, params["shape.vertex_positions"])
    estimates = []
    for seed in range(8):
        offset = mi.Float(OFFSET)
        dr.enable_grad(offset)
        params["shape.vertex_positions"] = dr.ravel(start + mi.Vector3f(offset, 0, 0))
        params.update()
        image = mi.render(scene, params, seed=seed, spp=256)
        dr.backward(dr.sum(image * mi.TensorXf(weights().astype(np.float32)), axis=None))
        estimates.append(float(dr.grad(offset)[0]))
    assert agrees(slope("ball"), estimates, 0.03)

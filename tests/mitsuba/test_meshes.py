"""Our rasterizer beside Mitsuba: one scene, two renderers."""

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

SIDE = 32
WHERE = (2.2, 1.5, 4.0)
COLOUR = [0.8, 0.4, 0.2]
OFFSET, STEP = 0.2, 0.02
SHAPES = {
    "box": (trimesh.creation.box((2.0, 2.0, 2.0)), box((2.0, 2.0, 2.0))),
    "ball": (trimesh.Trimesh(sphere().vertices.numpy(), sphere().faces, process=False), sphere()),
}


def theirs(shape: str, folder: Path, offset: float = 0.0) -> Any:
    """Mitsuba's own shapes have vertices of each face's own, whose outlines its gradient counts several times."""
    mi.set_variant("llvm_ad_rgb")
    SHAPES[shape][0].export(folder / "shape.ply")
    view = mi.ScalarTransform4f().look_at(list(WHERE), [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "filter": {"type": "box"}, "sample_border": True}
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


def ours(shape: str, offset: torch.Tensor) -> torch.Tensor:
    made = replace(SHAPES[shape][1], colours=COLOUR, material=Material(ambient=0.0, diffuse=1.0, specular=0.0))
    moved = replace(made, vertices=made.vertices + torch.stack([offset, 0.0 * offset, 0.0 * offset]))
    return draw([moved], Camera(WHERE), SIDE, SIDE, lights=[Light(direction=(-1.0, -2.0, -3.0))])


def weights() -> Host:
    coarse = np.random.default_rng(0).normal(size=(4, 4, 3))
    return np.repeat(np.repeat(coarse, SIDE // 4, axis=0), SIDE // 4, axis=1)


def slope(shape: str) -> float:
    leaf = torch.tensor(OFFSET, dtype=torch.float64, requires_grad=True)
    (ours(shape, leaf) * torch.from_numpy(weights())).sum().backward()  # type: ignore[no-untyped-call]  # untyped in torch
    assert leaf.grad is not None
    return float(leaf.grad)


def agreed(value: float, estimates: list[float], rtol: float) -> bool:
    """Within four standard errors of the mean, and what shading at the centres of pixels leaves."""
    error = 4.0 * np.std(estimates, ddof=1) / np.sqrt(len(estimates))
    return bool(abs(value - np.mean(estimates)) < error + rtol * abs(np.mean(estimates)))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_looks_the_same(shape: str, tmp_path: Path) -> None:
    image = np.array(mi.render(theirs(shape, tmp_path, OFFSET), spp=1024))
    difference = np.abs(ours(shape, torch.tensor(OFFSET, dtype=torch.float64)).numpy() - image)
    assert difference.mean() < 2e-3
    assert difference.max() < 0.1  # where the ball turns away from the light within a pixel


def test_the_gradient_of_a_box_is_the_slope_of_its_images(tmp_path: Path) -> None:
    scenes = [theirs("box", tmp_path, OFFSET + sign * STEP) for sign in (1.0, -1.0)]
    estimates = []
    for seed in range(6):
        ahead, behind = (np.array(mi.render(scene, spp=256, seed=seed), dtype=np.float64) for scene in scenes)
        estimates.append(float(np.sum((ahead - behind) * weights())) / (2.0 * STEP))
    assert agreed(slope("box"), estimates, 0.005)


@pytest.mark.filterwarnings("ignore:a shape moves under a DirectionalEmitter:loi_mitsuba.GradientWarning")
def test_both_renderers_have_one_gradient_of_a_box(tmp_path: Path) -> None:
    scene = theirs("box", tmp_path)
    renderer = MitsubaRenderer(scene, {"x": Translate("shape", (1, 0, 0))}, integrator="scene", spp_grad=256)
    weight = weights().astype(np.float32)
    estimates = [float(renderer.vjp({"x": np.float32(OFFSET)}, weight, seed=seed)["x"]) for seed in range(8)]
    assert agreed(slope("box"), estimates, 0.03)


@thorough
def test_the_gradient_of_a_ball_is_that_of_its_outline(tmp_path: Path) -> None:
    scene = theirs("ball", tmp_path)
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
    assert agreed(slope("ball"), estimates, 0.03)

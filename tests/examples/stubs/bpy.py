"""A stand-in for Blender's bpy: cubes and a sun, drawn by the library's own rasteriser for a camera that looks down."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from loi_core.io.images import write_png
from loi_torch.mesh import Camera, Light, box, draw

LENS, SENSOR_WIDTH = 50.0, 36.0  # mm, of a new camera


@dataclass
class Object:
    location: Any = (0.0, 0.0, 0.0)
    rotation_euler: Any = (0.0, 0.0, 0.0)  # radians, about x, then y, then z
    scale: Any = (1.0, 1.0, 1.0)
    data: Any = field(default_factory=SimpleNamespace)

    def __post_init__(self) -> None:
        self.location, self.rotation_euler = np.array(self.location), np.array(self.rotation_euler)


@dataclass
class Scene:
    camera: Object | None = None
    cycles: Any = field(default_factory=lambda: SimpleNamespace(samples=4096, use_denoising=True, seed=0))
    render: Any = field(default_factory=lambda: SimpleNamespace(image_settings=SimpleNamespace(color_mode="RGBA")))
    suns: list[Object] = field(default_factory=list)
    cubes: list[Object] = field(default_factory=list)


context = SimpleNamespace(scene=Scene(), object=None)


def _rotation(angles: Any) -> np.ndarray[Any, Any]:
    product = np.eye(3)
    for axis, angle in enumerate(angles):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[first, second], [first, second]] = math.cos(angle)
        turn[second, first], turn[first, second] = math.sin(angle), -math.sin(angle)
        product = turn @ product
    return product


def _read_factory_settings(*, use_empty: bool = False) -> None:
    context.scene, context.object = Scene(), None


def _camera_add(*, location: Any) -> None:
    context.object = Object(location)


def _light_add(*, type: str, rotation: Any) -> None:  # noqa: A002  # Blender's name
    assert type == "SUN"
    context.object = Object(rotation_euler=rotation, data=SimpleNamespace(energy=1.0))
    context.scene.suns.append(context.object)


def _primitive_cube_add(*, scale: Any) -> None:
    context.object = Object(scale=scale)  # of a cube with edges of 2
    context.scene.cubes.append(context.object)


def _render(*, write_still: bool = False) -> None:
    scene, settings = context.scene, context.scene.render
    width, height = settings.resolution_x, settings.resolution_y
    meshes = []
    for cube in scene.cubes:
        mesh = box(2.0 * np.array(cube.scale), colours=(0.8, 0.8, 0.8))
        turned = mesh.vertices @ torch.tensor(_rotation(cube.rotation_euler).T)
        meshes.append(replace(mesh, vertices=turned + torch.tensor(cube.location)))
    lights = [
        Light(direction=_rotation(sun.rotation_euler) @ (0.0, 0.0, -1.0), colour=sun.data.energy / math.pi)
        for sun in scene.suns
    ]
    eye, focal = scene.camera.location, LENS / SENSOR_WIDTH * width
    camera = Camera(eye, target=eye - (0.0, 0.0, 1.0), focal=(focal, focal))
    image = draw(meshes, camera, height, width, lights=lights)
    if write_still:
        write_png(Path(settings.filepath), image.clamp(0.0, 1.0).numpy())


ops = SimpleNamespace(
    wm=SimpleNamespace(read_factory_settings=_read_factory_settings),
    object=SimpleNamespace(camera_add=_camera_add, light_add=_light_add),
    mesh=SimpleNamespace(primitive_cube_add=_primitive_cube_add),
    render=SimpleNamespace(render=_render),
)

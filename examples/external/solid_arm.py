"""The joints of a robot's arm from a photograph, 15 degrees off."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from examples.external.problem import Problem, Start, needs
from examples.external.solid_turns import host, parameters_like
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy
from loi_torch.mesh import Camera, Light, Mesh, box, draw
from loi_torch.painted import Painted, Tensors

__all__ = ["ARMS", "Arm"]

HEIGHT_PX, WIDTH_PX = 96, 128
LENGTHS: Final = (0.5, 1.2, 1.0, 0.5)  # of the links, from the base on
THICKNESSES: Final = (0.6, 0.34, 0.28, 0.22)
COLOURS: Final = ((0.5, 0.5, 0.55), (0.85, 0.4, 0.1), (0.85, 0.55, 0.1), (0.2, 0.4, 0.8))
AXES: Final = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
"""Axes of the joints in the frames of their links: the base turns about the vertical, the others bend."""

OFF: Final = 15.0  # degrees, of every joint
JOINT_BOUND: Final = 90.0  # degrees
GOALS: Final = 50.0  # degrees: range of the photograph's joints, to either side
GROUND: Final = 0.25


class _Joints:
    """The joints, in degrees; implements :class:`loi_torch.painted.HostScene`."""

    def parameters(self) -> dict[str, Host]:
        return {"joints": np.zeros(len(AXES))}

    def checked(self, params: Mapping[str, object]) -> dict[str, Host]:
        return {"joints": host(params["joints"])}

    def project(self, params: dict[str, Host]) -> dict[str, Host]:
        return {"joints": host(params["joints"])}


class Arm(Painted):
    """Renderer of a chain of boxes; the parameter ``joints`` has an angle in degrees for each."""

    def __init__(self) -> None:
        super().__init__(_Joints(), "float64", "cpu")
        self._camera = Camera((1.2, 2.6, 6.0), target=(0.0, 1.1, 0.0), fov=40.0)
        self._lights = (Light(direction=(-1.0, -2.0, -3.0), colour=0.8), Light(colour=0.4))
        self._links = [
            box((thickness, length, thickness), (0.0, 0.5 * length, 0.0), colours=colour)
            for length, thickness, colour in zip(LENGTHS, THICKNESSES, COLOURS, strict=True)
        ]

    def _paint(self, scene: Tensors) -> Tensor:
        angles = torch.deg2rad(scene["joints"])
        turn, origin = torch.eye(3, dtype=angles.dtype), torch.zeros(3, dtype=angles.dtype)
        meshes = []
        for link, length, axis, angle in zip(self._links, LENGTHS, AXES, angles, strict=True):
            turn = turn @ _rotation(torch.tensor(axis, dtype=angles.dtype), angle)
            vertices = link.vertices @ turn.T + origin
            meshes.append(Mesh(vertices, link.faces, link.colours, smooth=False, topology=None))
            origin = origin + length * turn[:, 1]
        return draw(meshes, self._camera, HEIGHT_PX, WIDTH_PX, lights=self._lights, background=GROUND)


def _rotation(axis: Tensor, angle: Tensor) -> Tensor:
    x, y, z = axis
    zero = torch.zeros_like(x)
    cross = torch.stack([torch.stack([zero, -z, y]), torch.stack([z, zero, -x]), torch.stack([-y, x, zero])])
    return torch.eye(3, dtype=axis.dtype) + torch.sin(angle) * cross + (1.0 - torch.cos(angle)) * cross @ cross


def arm_that_is_off(seed: int) -> Start:
    """Return an arm with every joint so many degrees from its angle in the photograph, to either side."""
    rng = np.random.default_rng(seed)
    goal = rng.uniform(-GOALS, GOALS, len(AXES))
    start = goal + OFF * np.where(rng.random(len(AXES)) < 0.5, -1.0, 1.0)
    renderer = Arm()
    target = to_numpy(renderer.render(parameters_like(renderer.parameters(), {"joints": goal})))
    return Start(renderer, target, {"joints": Free(start, -JOINT_BOUND, JOINT_BOUND)}, partial(_error, goal))


def _error(goal: Host, params: Mapping[str, Any]) -> float:
    return float(np.max(np.abs(host(params["joints"]) - goal)))


ARMS: Final = tuple(
    Problem(
        f"arm 15 degrees off, {steps} steps",
        arm_that_is_off,
        "degrees",
        3.0,
        steps=steps,
        renders=steps + 60,
        starts=6,
        source="a user of the library",
        licence="none needed",
        missing=needs("torch", "trimesh"),
        quick=steps == 80,
    )
    for steps in (80, 200)
)

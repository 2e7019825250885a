"""Orientations of painted cubes, from random starts: as nvdiffrast and pertrenderer test theirs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from examples.external.problem import Problem, Start, needs
from examples.external.solid_turns import host, matrix_of, parameters_like, random_rows, turn_between
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy
from loi_torch.mesh import Camera, Light, Mesh, MeshRenderer, Rotate, box

__all__ = ["CUBES"]

SIDE_PX: Final = 256
HALF_TANGENT: Final = 0.4  # of the field of view of nvdiffrast's example
DISTANCE: Final = 3.5  # from the camera to the centre of a cube of side 1
MIN_COSINE: Final = 0.1  # between a side's normal and the direction to the camera
PAINTS: Final = (
    (0.95, 0.95, 0.95),
    (0.9, 0.85, 0.1),
    (0.1, 0.15, 0.9),
    (0.1, 0.8, 0.2),
    (0.9, 0.1, 0.1),
    (0.95, 0.5, 0.05),
)
"""A colour for each side: those of the toy."""

STICKERS_SIDE_PX: Final = 128
STICKERS: Final = 3  # along each edge
STICKERS_DISTANCE: Final = 6.7  # from the camera to a cube of side 2
STICKERS_FOV: Final = 60.0  # degrees
STICKERS_STARTS: Final = (20.0, 90.0)  # degrees: pertrenderer's perturbation, and a larger angle


def painted_cube(seed: int) -> Start:
    """Return a cube of six colours in a random orientation, to be turned into another.

    The camera, the size of cube and image, and the uniformly distributed orientations are facts of nvdiffrast's example
    ``samples/torch/pose.py``, whose licence is not commercial; its code and its file are not used.
    """
    rng = np.random.default_rng(seed)
    goal = random_rows(rng)
    while _seen_sides(goal) < 2:  # a square of one colour has four solutions
        goal = random_rows(rng)
    cube = box(colours=np.repeat(PAINTS, 2, axis=0))
    camera = Camera((0.0, 0.0, DISTANCE), fov=2.0 * np.degrees(np.arctan(HALF_TANGENT)))
    return _turned({"cube": cube}, SIDE_PX, camera, {}, random_rows(rng), goal)


def cube_of_stickers(degrees: float, seed: int) -> Start:
    """Return a cube of coloured stickers, shaded, a number of degrees from its orientation in the photograph.

    Camera, image size and perturbation are facts of pertrenderer's ``experiments/eval.py`` (BSD-2-Clause); the stickers
    are arranged at random.
    """
    rng = np.random.default_rng(seed)
    goal = random_rows(rng)
    axis = rng.standard_normal(3)
    start = goal @ _rotation(axis / np.linalg.norm(axis), np.radians(degrees)).T
    camera = Camera(STICKERS_DISTANCE * np.array([0.75, 0.5, -0.433]), fov=STICKERS_FOV)
    lights = {"lamp": Light(position=(0.0, 2.0, -2.0), colour=0.8), "sky": Light(colour=0.3)}
    return _turned({"cube": _stickers(rng)}, STICKERS_SIDE_PX, camera, lights, start, goal)


def _seen_sides(rows: Host) -> int:
    """Return how many sides of a cube of side 1 the camera sees at an angle that is not too flat."""
    axes = matrix_of(rows).T  # of the sides, in the world
    to_camera = np.array([0.0, 0.0, DISTANCE])
    cosines = [
        normal @ (to_camera - 0.5 * normal) / np.linalg.norm(to_camera - 0.5 * normal)
        for axis in axes
        for normal in (axis, -axis)
    ]
    return int(np.sum(np.array(cosines) > MIN_COSINE))


def _stickers(rng: np.random.Generator) -> Mesh:
    """Return a cube of side 2 whose sides are grids of squares in random colours of the palette."""
    ticks = np.linspace(-1.0, 1.0, STICKERS + 1)
    across, up = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    corner = np.array([[j * (STICKERS + 1) + i for i in range(STICKERS)] for j in range(STICKERS)]).ravel()
    row = STICKERS + 1
    squares = np.stack([corner, corner + 1, corner + row + 1, corner, corner + row + 1, corner + row], axis=-1)
    vertices: list[Host] = []
    faces: list[Host] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            points = np.empty((len(across), 3))
            points[:, axis], points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = sign, sign * across, up
            vertices.append(points)
            faces.append(squares.reshape(-1, 3) + len(points) * len(faces))
    colours = np.array(PAINTS)[rng.integers(0, len(PAINTS), 6 * STICKERS**2)]
    return Mesh(np.concatenate(vertices), np.concatenate(faces), np.repeat(colours, 2, axis=0), smooth=False)


def _turned(
    meshes: Mapping[str, Mesh], side_px: int, camera: Camera, lights: Mapping[str, Light], start: Host, goal: Host
) -> Start:
    renderer = MeshRenderer(side_px, side_px, meshes, camera, {"turn": Rotate("cube", pivot=(0, 0, 0))}, lights=lights)
    target = to_numpy(renderer.render(parameters_like(renderer.parameters(), {"turn": goal})))
    return Start(renderer, target, {"turn": Free(start, -1.0, 1.0)}, partial(_error, goal))


def _error(goal: Host, params: Mapping[str, Any]) -> float:
    return turn_between(host(params["turn"]), goal)


def _rotation(axis: Host, angle: float) -> Host:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Host = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return matrix


def _problem(
    name: str,
    make: Callable[[int], Start],
    tolerance: float,
    source: str,
    licence: str,
    *,
    starts: int,
    steps: int = 200,
) -> Problem:
    return Problem(
        name,
        make,
        "degrees",
        tolerance,
        steps=steps,
        renders=300,
        starts=starts,
        source=source,
        licence=licence,
        missing=needs("torch", "trimesh"),
    )


CUBES: Final = (
    _problem(
        "painted cube",
        painted_cube,
        1.0,
        "NVlabs/nvdiffrast, samples/torch/pose.py",
        "not commercial; facts alone, the colours are others",
        starts=12,
        steps=100,  # the rest of the budget is for a search
    ),
    *(
        _problem(
            f"cube of stickers, {degrees:.0f} degrees",
            partial(cube_of_stickers, degrees),
            1.0,
            "quentinll/pertrenderer, experiments/eval.py",
            "BSD-2-Clause; facts alone",
            starts=6,
        )
        for degrees in STICKERS_STARTS
    ),
)

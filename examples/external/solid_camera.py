"""The position of a camera from a silhouette, as PyTorch3D's tutorial finds it, and from farther away."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.external.problem import Problem, Start, needs
from examples.external.solid_turns import direction_at_angle, host, parameters_like
from loi_core import Free
from loi_core.support.arrays import Host, to_numpy
from loi_torch.mesh import Camera, Mesh, MeshRenderer, read_mesh

__all__ = ["CAMERAS", "TEAPOT_VARIABLE", "teapot"]

TEAPOT_VARIABLE: Final = "LOI_TEAPOT"
"""Environment variable with the path of a teapot, such as the tutorial's ``teapot.obj``."""

SIDE_PX: Final = 256
FOV: Final = 60.0  # degrees
DISTANCE: Final = 3.0
AZIMUTH: Final = 0.0  # degrees
ELEVATION: Final = 50.0  # degrees
OTHER_GOALS: Final = ((-40.0, 20.0), (40.0, 60.0))  # ranges of azimuth and elevation in degrees, for seeds above 0
TUTORIAL_START: Final = (3.0, 6.9, 2.5)
BOUND: Final = 8.0  # of each coordinate
DISTANCES: Final = (3.0, 6.0)  # from the teapot to a start that is so many degrees away
START_DEGREES: Final = (60.0, 90.0, 120.0)
MIN_OFF_AXIS: Final = 0.2  # sine of the angle between a start and the vertical, along which a camera has no upright
SEGMENTS: Final = 32


@cache
def teapot() -> Mesh:
    """Return the teapot of the file that the environment variable names, or else a pot with a spout and a handle."""
    path = os.environ.get(TEAPOT_VARIABLE)
    white = (1.0, 1.0, 1.0)
    if path:
        return read_mesh(Path(path), colours=white)
    heights = np.array([-0.5, -0.5, -0.35, -0.05, 0.25, 0.42, 0.5, 0.52, 0.62, 0.66, 0.66])
    radii = np.array([1e-3, 0.45, 0.62, 0.68, 0.55, 0.38, 0.2, 0.06, 0.1, 0.06, 1e-3])
    body = _tube(np.stack([0.0 * heights, heights, 0.0 * heights], axis=-1), radii)
    bend = np.linspace(0.0, 1.0, 12)
    spout = _tube(np.stack([0.5 + 0.6 * bend, -0.2 + 0.65 * bend**1.6, 0.0 * bend], axis=-1), 0.17 - 0.11 * bend)
    arc = np.linspace(-0.4 * np.pi, 0.45 * np.pi, 16)
    handle = _tube(
        np.stack([-0.55 - 0.42 * np.cos(arc), 0.05 + 0.32 * np.sin(arc), 0.0 * arc], axis=-1), np.full(16, 0.06)
    )
    parts, count, vertices, faces = (body, spout, handle), 0, [], []
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return Mesh(np.concatenate(vertices), np.concatenate(faces), white)


def from_the_tutorial(seed: int) -> Start:
    """Return the tutorial's own start, and its photograph for seed 0."""
    return _start(np.array(TUTORIAL_START), _goal(seed))


def from_an_angle(degrees: float, seed: int) -> Start:
    """Return a start that looks at the teapot from this angle to the direction of the photograph."""
    rng = np.random.default_rng([seed, round(degrees)])
    goal = _goal(seed)
    while True:
        direction = direction_at_angle(goal, degrees, rng)
        if np.hypot(direction[0], direction[2]) > MIN_OFF_AXIS:
            return _start(rng.uniform(*DISTANCES) * direction, goal)


def _start(start: Host, goal: Host) -> Start:
    renderer = MeshRenderer(
        SIDE_PX,
        SIDE_PX,
        {"teapot": teapot()},
        Camera(start, fov=FOV),
        {"position": "camera.position"},
        lights={},
    )
    soft = to_numpy(renderer.render(parameters_like(renderer.parameters(), {"position": goal})))
    free = {"position": Free(start, -BOUND, BOUND)}
    return Start(renderer, np.rint(soft), free, partial(_error, goal))  # the tutorial's silhouette is a hard mask


def _goal(seed: int) -> Host:
    """Return the tutorial's camera for seed 0, and others around it."""
    azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
    if seed:
        lowest, highest = np.radians(np.array(OTHER_GOALS))
        azimuth, elevation = np.random.default_rng(seed).uniform(lowest, highest)
    flat = DISTANCE * np.cos(elevation)
    return np.array([flat * np.sin(azimuth), DISTANCE * np.sin(elevation), flat * np.cos(azimuth)])


def _error(goal: Host, params: Mapping[str, Any]) -> float:
    """Return the distance to the goal, as the angle at which it appears from the teapot if it is small."""
    return float(np.degrees(np.linalg.norm(host(params["position"]) - goal) / np.linalg.norm(goal)))


def _tube(centres: Host, radii: Host) -> tuple[Host, Host]:
    """Return vertices and triangles of a tube in the plane z = 0 along a line of centres."""
    tangents = np.gradient(centres, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
    tangents[np.linalg.norm(tangents, axis=1) < 0.5] = (0.0, 1.0, 0.0)
    sideways = np.stack([tangents[:, 1], -tangents[:, 0], np.zeros(len(centres))], axis=-1)
    angles = np.arange(SEGMENTS) * 2.0 * np.pi / SEGMENTS
    circle = np.cos(angles)[:, None, None] * sideways + np.sin(angles)[:, None, None] * np.array([0.0, 0.0, -1.0])
    vertices = (centres + radii[:, None] * circle).reshape(-1, 3)
    rings, faces = len(centres), []
    for segment in range(SEGMENTS):
        for ring in range(rings - 1):
            a, b = segment * rings + ring, (segment + 1) % SEGMENTS * rings + ring
            faces += [(a, b, b + 1), (a, b + 1, a + 1)]
    return vertices, np.array(faces)


def _problem(name: str, make: Callable[[int], Start], *, starts: int) -> Problem:
    return Problem(
        name,
        make,
        "degrees",
        2.0,
        steps=100,  # the rest of the budget is for a search
        renders=300,
        starts=starts,
        source="PyTorch3D, tutorial on camera positions; the teapot is a stand-in unless LOI_TEAPOT names a file",
        licence="BSD-3-Clause",
        missing=needs("torch", "trimesh"),
    )


CAMERAS: Final = (
    _problem("camera of a teapot, the tutorial's start", from_the_tutorial, starts=1),
    *(
        _problem(f"camera of a teapot, {degrees:.0f} degrees", partial(from_an_angle, degrees), starts=2)
        for degrees in START_DEGREES
    ),
)

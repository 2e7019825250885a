"""The problem of each column: a scene, its views, the start of a fit, and the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import deodr
import numpy as np
import torch
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from examples.paper.table3.teapot import teapot
from loi_core.renderers.poses import ParameterTarget
from loi_torch.mesh import (
    Camera,
    Environment,
    Light,
    Material,
    Mesh,
    MeshRenderer,
    Rotate,
    Translate,
    box,
    quad,
    read_mesh,
)

__all__ = ["COLUMNS", "Column", "FloatArray", "Problem", "image_of"]

FloatArray: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]

IMAGE_SIDE: Final = 128
FOV: Final = 60.0
CUBE_MAP_SIDE: Final = 128  # texels; 512 in the released code
DEGREES_PER_RADIAN: Final = 180.0 / np.pi
START_NOISE: Final = (
    1e-5  # world units; standard deviation between the starts of Shape, about the size of rounding errors
)
AXES: Final = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
HEADLIGHT: Final = {"light": Light()}
PLASTIC: Final = Material(ambient=0.0, diffuse=0.8, specular=0.2)


@dataclass(frozen=True)
class Column:
    """One column of the table.

    Attributes
    ----------
    name : str
    views : int
    seeds : int
        Number of starts; the paper has one start for *Shape*.
    error : "MAE" or "SSIM"
        Second measure, after PSNR.
    side : int
        Side of the square image, in pixels.
    """

    name: str
    views: int
    seeds: int
    error: str
    side: int = IMAGE_SIDE


COLUMNS: Final = (
    Column("Translation", 6, 10, "MAE"),
    Column("Rotation", 6, 10, "MAE"),
    Column("Shape", 1, 10, "MAE"),
    Column("Trans. + Rot.", 4, 10, "MAE"),
    Column("Camera pose", 1, 10, "SSIM"),
    Column("Material", 6, 10, "SSIM"),
    Column("Env. map", 6, 1, "SSIM"),
)


@dataclass(frozen=True)
class Problem:
    """One start and its target.

    Attributes
    ----------
    column : Column
    views : dict of MeshRenderer
        Views of the scene, by name.
    matching_views : dict of MeshRenderer
        The same views with aliased outlines and with positions, for RGBXY.
    goal, start : dict of arrays
        Parameters of the target and of the start.
    targets : dict of array, shape (side, side, 3)
        Images of the views at the goal.
    """

    column: Column
    views: dict[str, MeshRenderer]
    matching_views: dict[str, MeshRenderer]
    goal: dict[str, FloatArray]
    start: dict[str, FloatArray]
    targets: dict[str, FloatArray] = field(repr=False)

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """Return the problem of a column and seed."""
        rng = np.random.default_rng([seed, [listed.name for listed in COLUMNS].index(column.name)])
        scene = SCENES[column.name](rng)
        options: dict[str, Any] = {"lights": scene.lights, "environment": scene.environment}
        renderers = [
            MeshRenderer(
                column.side,
                column.side,
                scene.meshes,
                scene.cameras[0],
                scene.parameters,
                positions=has_positions,
                dtype="float32",
                **options,
            )
            for has_positions in (False, True)
        ]
        if len(scene.cameras) == 1:
            views, matching_views = ({"view 1": renderer} for renderer in renderers)
        else:
            views, matching_views = (
                {f"view {number}": renderer.with_camera(camera) for number, camera in enumerate(scene.cameras, 1)}
                for renderer in renderers
            )
        goal = {name: value.numpy() for name, value in renderers[0].parameters().items()}
        targets = {name: image_of(view, goal) for name, view in views.items()}
        return cls(column, views, matching_views, goal, scene.start, targets)

    def bounds(self, name: str) -> tuple[Any, Any]:
        """Return the bounds of a parameter by our protocol: the range of the truth, or 0 and more for materials."""
        reach = {"translation": 2.0 if self.column.name == "Translation" else 8.0, "position": 5.0, "target": 1.5}
        if name.startswith("about"):
            return -90.0, 180.0
        if name in reach:
            return self.start[name] - reach[name], self.start[name] + reach[name]
        return (None, None) if name == "vertices" else (0.0, None)

    def unit(self, name: str) -> float:
        """Return the protocol's unit in the unit of the parameter: degrees per radian for angles, else 1."""
        return DEGREES_PER_RADIAN if name.startswith("about") else 1.0


@dataclass
class _Scene:
    meshes: dict[str, Mesh]
    cameras: list[Camera]
    parameters: dict[str, ParameterTarget]
    start: dict[str, FloatArray]
    lights: dict[str, Light] = field(default_factory=lambda: dict(HEADLIGHT))
    environment: Environment | None = None


def image_of(view: MeshRenderer, params: dict[str, FloatArray]) -> FloatArray:
    """Return the image of a view at parameters given as arrays."""
    rendered: FloatArray = view.render({name: torch.as_tensor(value) for name, value in params.items()}).numpy()
    return rendered


def _around(distance: float, offsets: FloatArray | None = None) -> list[Camera]:
    """Return cameras on both sides of the three axes, looking at the origin."""
    positions = distance * AXES + (0.0 if offsets is None else offsets)
    ups = [(0.0, 0.0, 1.0) if abs(axis[1]) else (0.0, 1.0, 0.0) for axis in AXES]
    return [Camera(position, up=up, fov=FOV) for position, up in zip(positions, ups, strict=True)]


def _normalised(mesh: Mesh, half_size: float) -> Mesh:
    """Return the mesh centred at the origin, with a longest side of 2 `half_size`."""
    lower, upper = mesh.vertices.amin(dim=0), mesh.vertices.amax(dim=0)
    return replace(mesh, vertices=half_size * (mesh.vertices - 0.5 * (lower + upper)) / (0.5 * (upper - lower).max()))


def _deodr_mesh(name: str, half_size: float) -> Mesh:
    path = Path(deodr.__file__).parent / "data" / name
    return _normalised(read_mesh(path, colours=(1.0, 1.0, 1.0), material=PLASTIC), half_size)


def _translation(rng: np.random.Generator) -> _Scene:
    return _Scene(
        {"duck": _deodr_mesh("duck.obj", 0.25)},
        _around(2.0, rng.uniform(-0.1, 0.1, (6, 3))),
        {"translation": Translate("duck")},
        {"translation": rng.uniform(-1.0, 1.0, 3)},
    )


def _rotation(rng: np.random.Generator) -> _Scene:
    names, axes = ("about x", "about y", "about z"), np.eye(3)
    angles = rng.uniform(0.0, 90.0, 3)
    return _Scene(
        {"hand": _deodr_mesh("hand.obj", 2.0)},
        _around(5.0),
        {name: Rotate("hand", tuple(axis), (0.0, 0.0, 0.0)) for name, axis in zip(names, axes, strict=True)},
        {name: np.array(angle) for name, angle in zip(names, angles, strict=True)},
    )


def _shape(rng: np.random.Generator) -> _Scene:
    outline = _outline("S", 160)
    triangles = _triangulated(outline)
    angle = 2.0 * np.pi * np.arange(len(outline)) / len(outline)
    first_angle = np.arctan2(*(outline[0] - outline.mean(axis=0))[::-1])
    circle = 1.2 * np.stack([np.cos(angle + first_angle), np.sin(angle + first_angle)], axis=1) + (0.8, -0.5)
    circle = circle + START_NOISE * rng.normal(size=circle.shape)
    vertices = [np.concatenate([points, np.zeros((len(points), 1))], axis=1) for points in (outline, circle)]
    return _Scene(
        {"outline": Mesh(vertices[0], triangles, colours=(1.0, 1.0, 1.0))},
        [Camera((0.0, 0.0, 5.0), fov=FOV)],
        {"vertices": "outline.vertices"},
        {"vertices": vertices[1]},
        {},
    )


def _pose(rng: np.random.Generator) -> _Scene:
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=float)
    directions = rng.normal(size=(4, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cube = box((2.0, 2.0, 2.0), colours=np.repeat(colours, 2, axis=0), per="triangle")
    names, axes = ("about x", "about y", "about z"), np.eye(3)
    parameters: dict[str, ParameterTarget] = {"translation": Translate("cube")}
    parameters |= {name: Rotate("cube", tuple(axis), (0.0, 0.0, 0.0)) for name, axis in zip(names, axes, strict=True)}
    angles = rng.uniform(0.0, 90.0, 3)
    return _Scene(
        {"cube": cube},
        [Camera(8.0 * direction, fov=FOV) for direction in directions],
        parameters,
        {
            "translation": rng.uniform(-4.0, 4.0, 3),
            **{name: np.array(angle) for name, angle in zip(names, angles, strict=True)},
        },
        {},
    )


def _camera(rng: np.random.Generator) -> _Scene:
    return _Scene(
        _room(),
        [Camera((0.0, 0.0, -12.0), fov=FOV)],
        {"position": "camera.position", "target": "camera.target"},
        {
            "position": np.array([0.0, 0.0, -12.0]) + rng.uniform(-5.0, 5.0, 3),
            "target": rng.uniform(-1.5, 1.5, 3),
        },
    )


def _room() -> dict[str, Mesh]:
    """Return a room of five walls, open towards -z, with two boxes in it."""
    matte = Material(ambient=0.1, diffuse=0.8, specular=0.0)

    def wall(colour: tuple[float, float, float], *corners: tuple[float, float, float]) -> Mesh:
        vertices = (tuple(5.0 * sign for sign in corner) for corner in corners)
        return quad(*vertices, colours=colour, smooth=False, material=matte)

    white = (0.8, 0.8, 0.8)
    return {
        "floor": wall(white, (-1, -1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1)),
        "ceiling": wall(white, (-1, 1, -1), (-1, 1, 1), (1, 1, 1), (1, 1, -1)),
        "back": wall(white, (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)),
        "red": wall((0.8, 0.1, 0.1), (1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)),
        "green": wall((0.1, 0.7, 0.1), (-1, -1, -1), (-1, -1, 1), (-1, 1, 1), (-1, 1, -1)),
        "tall": box((2.6, 5.6, 2.6), (1.8, -2.2, 1.8), colours=(0.8, 0.7, 0.5), material=matte),
        "short": box((2.6, 2.6, 2.6), (-1.8, -3.7, -0.8), colours=(0.4, 0.5, 0.8), material=matte),
    }


def _material(rng: np.random.Generator) -> _Scene:
    material = Material(ambient=0.1, diffuse=(0.7, 0.25, 0.15), specular=(0.3, 0.3, 0.2), shininess=64.0, mirror=0.4)
    mesh = teapot(1.2, colours=(1.0, 1.0, 1.0), material=material)
    start = {"cube map": np.full((6, CUBE_MAP_SIDE, CUBE_MAP_SIDE, 3), 0.5)}
    start |= {name: rng.uniform(0.0, 1.0, 3) for name in ("diffuse", "specular")}
    parameters: dict[str, ParameterTarget] = {"cube map": "environment.image", "diffuse": "teapot.diffuse"}
    parameters["specular"] = "teapot.specular"
    return _Scene({"teapot": mesh}, _around(3.0), parameters, start, environment=Environment(_surroundings()))


def _environment(_: np.random.Generator) -> _Scene:
    mesh = _deodr_mesh("duck.obj", 1.2)
    mesh = replace(mesh, material=Material(ambient=0.0, diffuse=0.0, specular=0.0, mirror=1.0))
    start = {"cube map": np.full((6, CUBE_MAP_SIDE, CUBE_MAP_SIDE, 3), 0.5)}
    return _Scene(
        {"duck": mesh},
        _around(3.0),
        {"cube map": "environment.image"},
        start,
        {},
        Environment(_surroundings()),
    )


def _surroundings() -> FloatArray:
    """Return a cube map of a sky with a sun and clouds above a chequered ground."""
    centres = (np.arange(CUBE_MAP_SIDE) + 0.5) / CUBE_MAP_SIDE * 2.0 - 1.0
    v, u = np.meshgrid(centres, centres, indexing="ij")
    w = np.ones_like(u)
    faces = [(w, -v, -u), (-w, -v, u), (u, w, v), (u, -w, -v), (u, -v, w), (-u, -v, -w)]
    directions = np.stack([np.stack(face, axis=-1) for face in faces])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(directions, -1, 0)
    sky = np.stack([0.35 + 0.3 * (1.0 - y), 0.5 + 0.25 * (1.0 - y), 0.8 + 0.0 * y], axis=-1)
    clouds = (0.5 + 0.5 * np.sin(7.0 * x + 3.0 * z) * np.sin(5.0 * z - 4.0 * x + 2.0))[..., None] ** 3
    sky = sky + (0.95 - sky) * 0.7 * clouds * np.clip(y, 0.0, 1.0)[..., None] ** 0.5
    sun = np.clip(40.0 * (directions @ np.array([0.48, 0.64, 0.6]) - 0.975), 0.0, 1.0)[..., None]
    depth = np.maximum(-y, 0.08)
    tiles = ((np.floor(1.5 * x / depth) + np.floor(1.5 * z / depth)) % 2.0)[..., None]
    ground = tiles * np.array([0.75, 0.7, 0.6]) + (1.0 - tiles) * np.array([0.2, 0.25, 0.2])
    image: FloatArray = np.where((y > 0.0)[..., None], sky + (1.0 - sky) * sun, ground)
    return image


def _outline(letter: str, count: int) -> FloatArray:
    """Return `count` equidistant points on the outline of a letter without holes, centred and of height 4."""
    path = TextPath((0, 0), letter, size=1, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    polygon = np.asarray(path.to_polygons()[0])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(polygon, axis=0), axis=1)))
    samples = np.linspace(0.0, length[-1], count, endpoint=False)
    points = np.stack([np.interp(samples, length, polygon[:, axis]) for axis in (0, 1)], axis=1)
    lower, upper = points.min(axis=0), points.max(axis=0)
    points = 4.0 * (points - 0.5 * (lower + upper)) / (upper[1] - lower[1])
    area = 0.5 * np.sum(points[:, 0] * np.roll(points[:, 1], -1) - points[:, 1] * np.roll(points[:, 0], -1))
    counterclockwise: FloatArray = points if area > 0.0 else points[::-1]
    return counterclockwise


def _triangulated(points: FloatArray) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return counterclockwise triangles of a simple polygon, by clipping ears, the least slender ear first."""
    polygon, triangles = list(range(len(points))), []

    def area(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = points[a], points[b], points[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    while len(polygon) > 3:
        best_ratio, best_ear = -1.0, 0
        for index in range(len(polygon)):
            a, b, c = polygon[index - 1], polygon[index], polygon[(index + 1) % len(polygon)]
            ear_area = area(a, b, c)
            if ear_area <= 0.0:
                continue
            longest = max(np.sum((points[p] - points[q]) ** 2) for p, q in ((a, b), (b, c), (c, a)))
            if ear_area / longest <= best_ratio:
                continue
            remaining = [p for p in polygon if p not in (a, b, c)]
            if not any(area(a, b, p) >= 0.0 and area(b, c, p) >= 0.0 and area(c, a, p) >= 0.0 for p in remaining):
                best_ratio, best_ear = ear_area / longest, index
        triangles.append((polygon[best_ear - 1], polygon[best_ear], polygon[(best_ear + 1) % len(polygon)]))
        polygon.pop(best_ear)
    return np.array([*triangles, tuple(polygon)])


SCENES: Final[dict[str, Callable[[np.random.Generator], _Scene]]] = {
    "Translation": _translation,
    "Rotation": _rotation,
    "Shape": _shape,
    "Trans. + Rot.": _pose,
    "Camera pose": _camera,
    "Material": _material,
    "Env. map": _environment,
}

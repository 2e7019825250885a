"""What is to be found in each column: the scene, its views, and where a fit begins."""

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

SIDE: Final = 128
FOV: Final = 60.0
FAR: Final = 100.0
CUBE: Final = 128  # texels along each side of a cube map; 512 in the released code
RADIAN: Final = 180.0 / np.pi
DIFFERENT: Final = 1e-5  # world units by which the starts of Shape differ: about what rounding makes of one start
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
        How many starts there are; the paper has one of *Shape*.
    error : "MAE" or "SSIM"
        What stands beside PSNR.
    side : int
        Of the square image, in pixels.
    """

    name: str
    views: int
    seeds: int
    error: str
    side: int = SIDE


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
    """One start, with its target.

    Attributes
    ----------
    column : Column
    views : dict of MeshRenderer
        Of the scene, by name.
    places : dict of MeshRenderer
        The same with jagged outlines and places, for RGBXY.
    goal, start : dict of arrays
        Parameters.
    targets : dict of array, shape (side, side, 3)
        What the views show at the goal.
    """

    column: Column
    views: dict[str, MeshRenderer]
    places: dict[str, MeshRenderer]
    goal: dict[str, FloatArray]
    start: dict[str, FloatArray]
    targets: dict[str, FloatArray] = field(repr=False)

    @classmethod
    def of(cls, column: Column, seed: int) -> Problem:
        """The problem of a column and seed."""
        rng = np.random.default_rng([seed, [one.name for one in COLUMNS].index(column.name)])
        made = SCENES[column.name](rng)
        options: dict[str, Any] = {"lights": made.lights, "environment": made.environment}
        by_kind = [
            MeshRenderer(
                column.side,
                column.side,
                made.meshes,
                made.cameras[0],
                made.parameters,
                positions=places,
                dtype="float32",
                **options,
            )
            for places in (False, True)
        ]
        if len(made.cameras) == 1:
            views, places = ({"view 1": one} for one in by_kind)
        else:
            views, places = (
                {f"view {k}": one.with_camera(camera) for k, camera in enumerate(made.cameras, 1)} for one in by_kind
            )
        goal = {name: value.numpy() for name, value in by_kind[0].parameters().items()}
        targets = {name: image_of(view, goal) for name, view in views.items()}
        return cls(column, views, places, goal, made.start, targets)

    def bounds(self, name: str) -> tuple[Any, Any]:
        """Within which our protocol looks: as far from the start as the truth may be, and what light may be."""
        reach = {"translation": 2.0 if self.column.name == "Translation" else 8.0, "position": 5.0, "target": 1.5}
        if name.startswith("about"):
            return -90.0, 180.0
        if name in reach:
            return self.start[name] - reach[name], self.start[name] + reach[name]
        return (None, None) if name == "vertices" else (0.0, None)

    def unit(self, name: str) -> float:
        """What 1 of the protocol is in a parameter's own unit: a radian is some degrees."""
        return RADIAN if name.startswith("about") else 1.0


@dataclass
class _Scene:
    meshes: dict[str, Mesh]
    cameras: list[Camera]
    parameters: dict[str, ParameterTarget]
    start: dict[str, FloatArray]
    lights: dict[str, Light] = field(default_factory=lambda: dict(HEADLIGHT))
    environment: Environment | None = None


def image_of(view: MeshRenderer, params: dict[str, FloatArray]) -> FloatArray:
    """What a view shows at parameters that are arrays."""
    rendered: FloatArray = view.render({name: torch.as_tensor(value) for name, value in params.items()}).numpy()
    return rendered


def _around(distance: float, offsets: FloatArray | None = None) -> list[Camera]:
    """Cameras on the six axes, looking at the origin."""
    places = distance * AXES + (0.0 if offsets is None else offsets)
    ups = [(0.0, 0.0, 1.0) if abs(axis[1]) else (0.0, 1.0, 0.0) for axis in AXES]
    return [Camera(place, up=up, fov=FOV) for place, up in zip(places, ups, strict=True)]


def _normalised(mesh: Mesh, half: float) -> Mesh:
    """The mesh about the origin, its longest side twice `half`."""
    low, high = mesh.vertices.amin(dim=0), mesh.vertices.amax(dim=0)
    return replace(mesh, vertices=half * (mesh.vertices - 0.5 * (low + high)) / (0.5 * (high - low).max()))


def _shipped(name: str, half: float) -> Mesh:
    path = Path(deodr.__file__).parent / "data" / name
    return _normalised(read_mesh(path, colours=(1.0, 1.0, 1.0), material=PLASTIC), half)


def _translation(rng: np.random.Generator) -> _Scene:
    return _Scene(
        {"duck": _shipped("duck.obj", 0.25)},
        _around(2.0, rng.uniform(-0.1, 0.1, (6, 3))),
        {"translation": Translate("duck")},
        {"translation": rng.uniform(-1.0, 1.0, 3)},
    )


def _rotation(rng: np.random.Generator) -> _Scene:
    names, axes = ("about x", "about y", "about z"), np.eye(3)
    angles = rng.uniform(0.0, 90.0, 3)
    return _Scene(
        {"hand": _shipped("hand.obj", 2.0)},
        _around(5.0),
        {name: Rotate("hand", tuple(axis), (0.0, 0.0, 0.0)) for name, axis in zip(names, axes, strict=True)},
        {name: np.array(angle) for name, angle in zip(names, angles, strict=True)},
    )


def _shape(rng: np.random.Generator) -> _Scene:
    outline = _outline("S", 160)
    triangles = _triangulated(outline)
    angle = 2.0 * np.pi * np.arange(len(outline)) / len(outline)
    first = np.arctan2(*(outline[0] - outline.mean(axis=0))[::-1])
    circle = 1.2 * np.stack([np.cos(angle + first), np.sin(angle + first)], axis=1) + (0.8, -0.5)
    circle = circle + DIFFERENT * rng.normal(size=circle.shape)
    flat = [np.concatenate([points, np.zeros((len(points), 1))], axis=1) for points in (outline, circle)]
    return _Scene(
        {"outline": Mesh(flat[0], triangles, colours=(1.0, 1.0, 1.0))},
        [Camera((0.0, 0.0, 5.0), fov=FOV)],
        {"vertices": "outline.vertices"},
        {"vertices": flat[1]},
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
        [Camera(8.0 * one, fov=FOV) for one in directions],
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
    """A box of five walls, open towards -z, with two boxes in it."""
    matte = Material(ambient=0.1, diffuse=0.8, specular=0.0)
    low, high = -5.0, 5.0
    corner = {(x, y, z): (x, y, z) for x in (low, high) for y in (low, high) for z in (low, high)}

    def wall(colour: tuple[float, float, float], *corners: tuple[float, float, float]) -> Mesh:
        return quad(*(corner[one] for one in corners), colours=colour, smooth=False, material=matte)

    white = (0.8, 0.8, 0.8)
    return {
        "floor": wall(white, (low, low, low), (high, low, low), (high, low, high), (low, low, high)),
        "ceiling": wall(white, (low, high, low), (low, high, high), (high, high, high), (high, high, low)),
        "back": wall(white, (low, low, high), (high, low, high), (high, high, high), (low, high, high)),
        "red": wall((0.8, 0.1, 0.1), (high, low, low), (high, high, low), (high, high, high), (high, low, high)),
        "green": wall((0.1, 0.7, 0.1), (low, low, low), (low, low, high), (low, high, high), (low, high, low)),
        "tall": box((2.6, 5.6, 2.6), (1.8, -2.2, 1.8), colours=(0.8, 0.7, 0.5), material=matte),
        "short": box((2.6, 2.6, 2.6), (-1.8, -3.7, -0.8), colours=(0.4, 0.5, 0.8), material=matte),
    }


def _material(rng: np.random.Generator) -> _Scene:
    made = Material(ambient=0.1, diffuse=(0.7, 0.25, 0.15), specular=(0.3, 0.3, 0.2), shininess=64.0, mirror=0.4)
    mesh = teapot(1.2, colours=(1.0, 1.0, 1.0), material=made)
    start = {"cube map": np.full((6, CUBE, CUBE, 3), 0.5)}
    start |= {name: rng.uniform(0.0, 1.0, 3) for name in ("diffuse", "specular")}
    parameters: dict[str, ParameterTarget] = {"cube map": "environment.image", "diffuse": "teapot.diffuse"}
    parameters["specular"] = "teapot.specular"
    return _Scene({"teapot": mesh}, _around(3.0), parameters, start, environment=Environment(_surroundings()))


def _environment(_: np.random.Generator) -> _Scene:
    mesh = _shipped("duck.obj", 1.2)
    mesh = replace(mesh, material=Material(ambient=0.0, diffuse=0.0, specular=0.0, mirror=1.0))
    start = {"cube map": np.full((6, CUBE, CUBE, 3), 0.5)}
    return _Scene(
        {"duck": mesh},
        _around(3.0),
        {"cube map": "environment.image"},
        start,
        {},
        Environment(_surroundings()),
    )


def _surroundings() -> FloatArray:
    """A cube map: a sky with a sun and clouds above a chequered ground."""
    at = (np.arange(CUBE) + 0.5) / CUBE * 2.0 - 1.0
    v, u = np.meshgrid(at, at, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, -v, -u), (-one, -v, u), (u, one, v), (u, -one, -v), (u, -v, one), (-u, -v, -one)]
    directions = np.stack([np.stack(face, axis=-1) for face in faces])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(directions, -1, 0)
    sky = np.stack([0.35 + 0.3 * (1.0 - y), 0.5 + 0.25 * (1.0 - y), 0.8 + 0.0 * y], axis=-1)
    clouds = (0.5 + 0.5 * np.sin(7.0 * x + 3.0 * z) * np.sin(5.0 * z - 4.0 * x + 2.0))[..., None] ** 3
    sky = sky + (0.95 - sky) * 0.7 * clouds * np.clip(y, 0.0, 1.0)[..., None] ** 0.5
    sun = np.clip(40.0 * (directions @ np.array([0.48, 0.64, 0.6]) - 0.975), 0.0, 1.0)[..., None]
    reach = np.maximum(-y, 0.08)
    tiles = ((np.floor(1.5 * x / reach) + np.floor(1.5 * z / reach)) % 2.0)[..., None]
    ground = tiles * np.array([0.75, 0.7, 0.6]) + (1.0 - tiles) * np.array([0.2, 0.25, 0.2])
    image: FloatArray = np.where((y > 0.0)[..., None], sky + (1.0 - sky) * sun, ground)
    return image


def _outline(letter: str, count: int) -> FloatArray:
    """The outline of a letter without holes, about the origin and 4 high, at `count` points of equal distances."""
    path = TextPath((0, 0), letter, size=1, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    polygon = np.asarray(path.to_polygons()[0])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(polygon, axis=0), axis=1)))
    at = np.linspace(0.0, length[-1], count, endpoint=False)
    points = np.stack([np.interp(at, length, polygon[:, k]) for k in (0, 1)], axis=1)
    low, high = points.min(axis=0), points.max(axis=0)
    points = 4.0 * (points - 0.5 * (low + high)) / (high[1] - low[1])
    area = 0.5 * np.sum(points[:, 0] * np.roll(points[:, 1], -1) - points[:, 1] * np.roll(points[:, 0], -1))
    counterclockwise: FloatArray = points if area > 0.0 else points[::-1]
    return counterclockwise


def _triangulated(points: FloatArray) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Triangles of a simple polygon, counterclockwise, by cutting off ears, the least slender first."""
    left, triangles = list(range(len(points))), []

    def area(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = points[a], points[b], points[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    while len(left) > 3:
        best, found = -1.0, 0
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            whole = area(a, b, c)
            if whole <= 0.0:
                continue
            longest = max(np.sum((points[p] - points[q]) ** 2) for p, q in ((a, b), (b, c), (c, a)))
            if whole / longest <= best:
                continue
            others = [p for p in left if p not in (a, b, c)]
            if not any(area(a, b, p) >= 0.0 and area(b, c, p) >= 0.0 and area(c, a, p) >= 0.0 for p in others):
                best, found = whole / longest, k
        triangles.append((left[found - 1], left[found], left[(found + 1) % len(left)]))
        left.pop(found)
    return np.array([*triangles, tuple(left)])


SCENES: Final[dict[str, Callable[[np.random.Generator], _Scene]]] = {
    "Translation": _translation,
    "Rotation": _rotation,
    "Shape": _shape,
    "Trans. + Rot.": _pose,
    "Camera pose": _camera,
    "Material": _material,
    "Env. map": _environment,
}

"""Shapes as arrays of parameters, one row per shape, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import FloatArray, check_dtype, check_parameters
from loi_core.support.wording import shown
from loi_torch.vector.shapes import Circle, Ellipse, Outline, Paint, Path, Rectangle, Shape

__all__ = ["Layer", "Part", "ShapeParameters"]

MIN_SIZE_PX: Final = 0.1  # a shape without area has no gradient and could never grow again
MIN_PATH_SCALE: Final = 0.01


@dataclass(frozen=True)
class Layer:
    """A fill, a bilinear fill (a blend) or a stroke, and its row in the parameters of that name."""

    shape: int
    kind: Literal["fill", "blend", "stroke"]
    row: int
    paint: Paint


@dataclass(frozen=True)
class Part:
    """An outline of a path: its first row of ``points``, and how many there are."""

    shape: int
    first: int
    count: int
    degrees: tuple[int, ...]
    closed: bool


class ShapeParameters:
    """The parameters of shapes on the host; see :class:`loi_torch.vector.Vector`."""

    def __init__(self, shapes: Sequence[Shape], dtype: str) -> None:
        self._dtype = check_dtype(dtype)
        self._shapes = _checked_shapes(shapes)
        self.layers: list[Layer] = []
        self.parts: list[Part] = []
        self.circles, self.ellipses, self.rectangles = (
            np.flatnonzero([isinstance(shape, shape_class) for shape in shapes]).astype(np.int64)
            for shape_class in (Circle, (Circle, Ellipse), Rectangle)
        )
        self.paths = np.flatnonzero([isinstance(shape, Path) for shape in shapes]).astype(np.int64)
        rows: dict[str, list[Any]] = {name: [] for name in ("fills", "blends", "strokes", "widths", "points")}
        poses: dict[str, list[Any]] = {"positions": [], "sizes": [], "rotations": [], "roundings": []}
        for index, shape in enumerate(shapes):
            self._add_paint(index, shape.paint, rows)
            rotation = 0.0
            if isinstance(shape, Circle):
                centre, size = np.asarray(shape.centre), np.full(2, shape.radius)
            elif isinstance(shape, Ellipse):
                centre, size, rotation = np.asarray(shape.centre), np.asarray(shape.radii), shape.rotation
            elif isinstance(shape, Rectangle):
                centre, size, rotation = np.asarray(shape.centre), 0.5 * np.asarray(shape.sides), shape.rotation
                poses["roundings"].append(shape.rounding)
            else:
                centre, size = self._add_path(index, shape, rows["points"]), np.ones(2)
            poses["positions"].append(centre)
            poses["sizes"].append(size)
            poses["rotations"].append(rotation)
        everything = poses | rows
        self._scene = {name: np.array(value, dtype=np.float64) for name, value in everything.items() if value}

    def parameters(self) -> dict[str, FloatArray]:
        """Return all parameters in the scene's dtype."""
        return {name: value.astype(self._dtype) for name, value in self._scene.items()}

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return `params` as float64 arrays; raise an error if names or shapes differ from the scene."""
        return check_parameters(params, self._scene)

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return `params` with positive areas and widths, round circles, and colours in [0, 1]."""
        scene = self.checked(params)
        sizes = scene["sizes"]
        sizes[self.circles] = np.mean(sizes[self.circles], axis=1, keepdims=True)
        min_sizes = np.full((len(sizes), 1), MIN_SIZE_PX)
        min_sizes[self.paths] = MIN_PATH_SCALE
        scene["sizes"] = np.maximum(sizes, min_sizes)
        if "roundings" in scene:
            max_roundings = scene["sizes"][self.rectangles].min(axis=1)
            scene["roundings"] = np.clip(scene["roundings"], 0.0, max_roundings)
        if "widths" in scene:
            scene["widths"] = np.maximum(scene["widths"], MIN_SIZE_PX)
        for name in ("fills", "blends", "strokes"):
            if name in scene:
                scene[name] = np.clip(scene[name], 0.0, 1.0)
        return {name: value.astype(self._dtype) for name, value in scene.items()}

    def shapes(self, params: Mapping[str, object]) -> list[Shape]:
        """Return the shapes with these parameters."""
        scene = self.checked(params)
        paints = [shape.paint for shape in self._shapes]
        for layer in self.layers:
            name = {"fill": "fills", "blend": "blends", "stroke": "strokes"}[layer.kind]
            colour = scene[name][layer.row]
            if layer.kind == "stroke":
                width = float(abs(scene["widths"][layer.row]))
                paints[layer.shape] = replace(paints[layer.shape], stroke=colour, width=width)
            else:
                paints[layer.shape] = replace(paints[layer.shape], fill=colour)
        return [self._shape(index, paint, scene) for index, paint in enumerate(paints)]

    def _shape(self, index: int, paint: Paint, scene: dict[str, FloatArray]) -> Shape:
        centre, size, rotation = scene["positions"][index], scene["sizes"][index], float(scene["rotations"][index])
        old = self._shapes[index]
        if isinstance(old, Path):
            angle = np.deg2rad(rotation)
            rotation_matrix = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            outlines = []
            for path_outline in self.parts:
                if path_outline.shape == index:
                    local = scene["points"][path_outline.first : path_outline.first + path_outline.count] * size
                    outlines.append(
                        Outline(local @ rotation_matrix + centre, path_outline.degrees, path_outline.closed)
                    )
            return Path(tuple(outlines), paint)
        size = np.abs(size)
        if isinstance(old, Rectangle):
            rounding = scene["roundings"][np.searchsorted(self.rectangles, index)]
            return Rectangle(centre, 2.0 * size, paint, float(np.clip(rounding, 0.0, size.min())), rotation)
        if isinstance(old, Circle) and size[0] == size[1]:
            return Circle(centre, float(size[0]), paint)
        return Ellipse(centre, size, paint, rotation)

    def _add_paint(self, index: int, paint: Paint, rows: dict[str, list[Any]]) -> None:
        if paint.fill is not None:
            blended = np.ndim(paint.fill) == 2
            name = "blends" if blended else "fills"
            self.layers.append(Layer(index, "blend" if blended else "fill", len(rows[name]), paint))
            rows[name].append(paint.fill)
        if paint.stroke is not None:
            self.layers.append(Layer(index, "stroke", len(rows["strokes"]), paint))
            rows["strokes"].append(paint.stroke)
            rows["widths"].append(paint.width)

    def _add_path(self, index: int, path: Path, points: list[Any]) -> FloatArray:
        """Append the path's points, relative to the centre of their bounding box, which is returned."""
        all_points = np.concatenate([np.asarray(outline.points, dtype=np.float64) for outline in path.outlines])
        centre: FloatArray = 0.5 * (all_points.min(axis=0) + all_points.max(axis=0))
        for outline in path.outlines:
            self.parts.append(Part(index, len(points), len(outline.points), outline.degrees, outline.closed))
            points.extend(np.asarray(outline.points, dtype=np.float64) - centre)
        return centre


def _checked_shapes(shapes: Sequence[Shape]) -> list[Shape]:
    if not isinstance(shapes, Sequence) or isinstance(shapes, str) or not shapes:
        msg = f"`shapes` must be a list of at least one shape, got {shown(shapes)}"
        raise ParameterError(msg)
    for shape in shapes:
        if not isinstance(shape, Circle | Ellipse | Rectangle | Path):
            msg = f"`shapes` must be Circle, Ellipse, Rectangle or Path, got {shown(shape)}"
            raise ParameterError(msg)
    return list(shapes)

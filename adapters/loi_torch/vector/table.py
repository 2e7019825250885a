"""Shapes as arrays: the parameters of a vector picture, one row a shape, and back to shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from loi_core.errors import ParameterError
from loi_core.renderers.validation import FloatArray, check_dtype, check_parameters
from loi_core.support.wording import shown
from loi_torch.vector.shapes import Circle, Ellipse, Outline, Paint, Path, Rectangle, Shape

__all__ = ["Layer", "Part", "Table"]

LEAST_SIZE: Final = 0.1  # pixels; without area a shape has no gradient, and could never come back
LEAST_SCALE: Final = 0.01  # of a path


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


class Table:
    """The parameters of shapes, as the renderer has them on the host; see :class:`loi_torch.vector.Vector`."""

    def __init__(self, shapes: Sequence[Shape], dtype: str) -> None:
        self._dtype = check_dtype(dtype)
        self._shapes = _checked_shapes(shapes)
        self.layers: list[Layer] = []
        self.parts: list[Part] = []
        self.circles, self.ellipses, self.rectangles = (
            np.flatnonzero([isinstance(one, kind) for one in shapes]).astype(np.int64)
            for kind in (Circle, (Circle, Ellipse), Rectangle)
        )
        self.paths = np.flatnonzero([isinstance(one, Path) for one in shapes]).astype(np.int64)
        rows: dict[str, list[Any]] = {name: [] for name in ("fills", "blends", "strokes", "widths", "points")}
        place: dict[str, list[Any]] = {"positions": [], "sizes": [], "rotations": [], "roundings": []}
        for index, shape in enumerate(shapes):
            self._add_paint(index, shape.paint, rows)
            rotation = 0.0
            if isinstance(shape, Circle):
                centre, size = np.asarray(shape.centre), np.full(2, shape.radius)
            elif isinstance(shape, Ellipse):
                centre, size, rotation = np.asarray(shape.centre), np.asarray(shape.radii), shape.rotation
            elif isinstance(shape, Rectangle):
                centre, size, rotation = np.asarray(shape.centre), 0.5 * np.asarray(shape.sides), shape.rotation
                place["roundings"].append(shape.rounding)
            else:
                centre, size = self._add_path(index, shape, rows["points"]), np.ones(2)
            place["positions"].append(centre)
            place["sizes"].append(size)
            place["rotations"].append(rotation)
        everything = place | rows
        self._scene = {name: np.array(value, dtype=np.float64) for name, value in everything.items() if value}

    def parameters(self) -> dict[str, FloatArray]:
        """All parameters, of the scene's dtype."""
        return {name: value.astype(self._dtype) for name, value in self._scene.items()}

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """`params` as float64 arrays, once they are known to have the scene's names and shapes."""
        return check_parameters(params, self._scene)

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """`params` with areas and widths that are positive, circles round, and colours in [0, 1]."""
        scene = self.checked(params)
        sizes = scene["sizes"]
        sizes[self.circles] = np.mean(sizes[self.circles], axis=1, keepdims=True)
        least = np.full((len(sizes), 1), LEAST_SIZE)
        least[self.paths] = LEAST_SCALE
        scene["sizes"] = np.maximum(sizes, least)
        if "roundings" in scene:
            most = scene["sizes"][self.rectangles].min(axis=1)
            scene["roundings"] = np.clip(scene["roundings"], 0.0, most)
        if "widths" in scene:
            scene["widths"] = np.maximum(scene["widths"], LEAST_SIZE)
        for name in ("fills", "blends", "strokes"):
            if name in scene:
                scene[name] = np.clip(scene[name], 0.0, 1.0)
        return {name: value.astype(self._dtype) for name, value in scene.items()}

    def shapes(self, params: Mapping[str, object]) -> list[Shape]:
        """The shapes that have these parameters."""
        scene = self.checked(params)
        paints = [one.paint for one in self._shapes]
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
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            outlines = []
            for part in self.parts:
                if part.shape == index:
                    local = scene["points"][part.first : part.first + part.count] * size
                    outlines.append(Outline(local @ turn + centre, part.degrees, part.closed))
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
        every = np.concatenate([np.asarray(one.points, dtype=np.float64) for one in path.outlines])
        centre: FloatArray = 0.5 * (every.min(axis=0) + every.max(axis=0))
        for outline in path.outlines:
            self.parts.append(Part(index, len(points), len(outline.points), outline.degrees, outline.closed))
            points.extend(np.asarray(outline.points, dtype=np.float64) - centre)
        return centre


def _checked_shapes(shapes: Sequence[Shape]) -> list[Shape]:
    if not isinstance(shapes, Sequence) or isinstance(shapes, str) or not shapes:
        msg = f"`shapes` must be a list of at least one shape, got {shown(shapes)}"
        raise ParameterError(msg)
    for one in shapes:
        if not isinstance(one, Circle | Ellipse | Rectangle | Path):
            msg = f"`shapes` must be Circle, Ellipse, Rectangle or Path, got {shown(one)}"
            raise ParameterError(msg)
    return list(shapes)

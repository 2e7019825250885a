"""Outlines of shapes as rings of points, close enough together that chords pass for curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.renderers.rasterization import IndexArray
from loi_core.renderers.validation import FloatArray
from loi_core.support.arrays import to_numpy
from loi_torch.painted import Tensors
from loi_torch.vector.table import ShapeParameters

__all__ = ["TOLERANCE", "Ring", "Rings", "ragged_arange", "ring_points"]

TOLERANCE: Final = 0.01  # pixels between a chord and its curve
MOST_CHORDS: Final = 4096  # of one curve


@dataclass(frozen=True)
class Ring:
    """The points of one outline, a range of all points; an open one is closed by a line only to be filled."""

    shape: int
    first: int
    beyond: int
    closed: bool


@dataclass(frozen=True)
class Rings:
    """The outlines of all shapes.

    Attributes
    ----------
    points : tensor, shape (k, 2), float64
        On the canvas, in pixels.
    local : tensor, shape (k, 2), float64
        The same before shapes are turned and moved.
    corner : array of bool, shape (k,)
        Whether a point is where two segments meet; otherwise it lies within a curve.
    rings : list of Ring
    """

    points: Tensor
    local: Tensor
    corner: np.ndarray[Any, np.dtype[np.bool_]]
    rings: list[Ring]


def ragged_arange(counts: IndexArray) -> tuple[IndexArray, IndexArray]:
    """For each of ``sum(counts)`` items, whose it is, and which of that owner's it is."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def ring_points(table: ShapeParameters, scene: Tensors) -> Rings:
    """The outlines of the shapes of `table` with the parameters `scene`, differentiable by these."""
    sizes = scene["sizes"]
    host: dict[str, FloatArray] = {name: to_numpy(value) for name, value in scene.items()}
    reach = _reach(table, host)
    local: list[Tensor] = []
    corner, rings = [], []
    owners: list[IndexArray] = []
    done = 0
    for sample in (_ellipses, _rectangles, _paths):
        points_of_kind, owner, corners, rings_of_kind = sample(table, scene, host, reach)
        local.append(points_of_kind)
        owners.append(owner)
        corner.append(corners)
        rings += [Ring(ring.shape, ring.first + done, ring.beyond + done, ring.closed) for ring in rings_of_kind]
        done += len(owner)
    everywhere = torch.cat(local)
    shape = torch.as_tensor(np.concatenate(owners), device=sizes.device)
    angle = torch.deg2rad(scene["rotations"])
    cos, sin = torch.cos(angle).index_select(0, shape), torch.sin(angle).index_select(0, shape)
    x, y = everywhere.unbind(dim=1)
    rotated = torch.stack([cos * x - sin * y, sin * x + cos * y], dim=1)
    points = rotated + scene["positions"].index_select(0, shape)
    return Rings(points, everywhere, np.concatenate(corner), rings)


def _reach(table: ShapeParameters, host: dict[str, FloatArray]) -> FloatArray:
    """How far from its outline a shape is painted."""
    reach = np.zeros(len(host["sizes"]))
    for layer in table.layers:
        if layer.kind == "stroke":
            reach[layer.shape] = 0.5 * abs(host["widths"][layer.row])
    return reach


def _chords(radius: FloatArray, angle: float) -> IndexArray:
    """How many chords of an arc stay within the tolerance of it."""
    step = np.sqrt(8.0 * TOLERANCE / np.maximum(radius, 0.1))
    return np.clip(np.ceil(angle / step), 2, MOST_CHORDS).astype(np.int64)


SampledOutlines = tuple[Tensor, IndexArray, np.ndarray[Any, np.dtype[np.bool_]], list[Ring]]


def _closed_rings(shapes: IndexArray, counts: IndexArray) -> list[Ring]:
    stops = np.cumsum(counts)
    return [
        Ring(int(shape), int(stop - count), int(stop), closed=True)
        for shape, count, stop in zip(shapes, counts, stops, strict=True)
    ]


def _ellipses(
    table: ShapeParameters, scene: Tensors, host: dict[str, FloatArray], reach: FloatArray
) -> SampledOutlines:
    shapes = table.ellipses
    radius = np.abs(host["sizes"][shapes]).max(axis=1, initial=0.0) + reach[shapes]
    counts = np.maximum(_chords(radius, 2.0 * np.pi), 8)
    row, index = ragged_arange(counts)
    angle = 2.0 * np.pi * index / counts[row]
    # The polygon is as large as the ellipse, so that its area does not depend on how many sides it has.
    step = 2.0 * np.pi / counts
    grown = np.sqrt(step / np.sin(step))[row]
    owner = shapes[row]
    unit = torch.as_tensor(np.stack([grown * np.cos(angle), grown * np.sin(angle)], axis=1), device=_device(scene))
    local = unit * scene["sizes"].index_select(0, torch.as_tensor(owner, device=_device(scene)))
    return local, owner, np.zeros(len(owner), dtype=bool), _closed_rings(shapes, counts)


def _rectangles(
    table: ShapeParameters, scene: Tensors, host: dict[str, FloatArray], reach: FloatArray
) -> SampledOutlines:
    shapes = table.rectangles
    device = _device(scene)
    if not len(shapes):
        return torch.zeros((0, 2), dtype=torch.float64, device=device), shapes, np.zeros(0, dtype=bool), []
    max_radius = np.abs(host["sizes"][shapes]).min(axis=1)
    radius = np.clip(host["roundings"], 0.0, max_radius)
    # A sharp corner has two points as well, so that it can become round.
    a_corner = np.where(radius > 0.0, _chords(radius + reach[shapes], 0.5 * np.pi), 1) + 1
    counts = 4 * a_corner
    row, index = ragged_arange(counts)
    quarter, step = np.divmod(index, a_corner[row])
    angle = 0.5 * np.pi * (quarter + step / (a_corner[row] - 1))
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])[quarter]
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=1) - signs
    sizes = torch.abs(scene["sizes"].index_select(0, torch.as_tensor(shapes, device=device)))
    rounding = torch.minimum(torch.clamp(scene["roundings"], min=0.0), sizes.amin(dim=1))
    rows = torch.as_tensor(row, device=device)
    local = torch.as_tensor(signs, device=device) * sizes.index_select(0, rows)
    local = local + torch.as_tensor(arc, device=device) * rounding.index_select(0, rows)[:, None]
    return local, shapes[row], np.ones(len(row), dtype=bool), _closed_rings(shapes, counts)


def _paths(table: ShapeParameters, scene: Tensors, host: dict[str, FloatArray], _: FloatArray) -> SampledOutlines:
    device = _device(scene)
    controls: list[list[int]] = []
    degrees: list[int] = []
    shapes, stops = [], []
    for outline in table.parts:
        at = 0
        for segment_degree in outline.degrees:
            controls.append([outline.first + (at + min(number, segment_degree)) % outline.count for number in range(4)])
            at += segment_degree
        degrees += outline.degrees
        shapes += [outline.shape] * len(outline.degrees)
        stops.append(len(degrees))
    if not degrees:
        return torch.zeros((0, 2), dtype=torch.float64, device=device), table.paths, np.zeros(0, dtype=bool), []
    control, degree, shape = np.array(controls), np.array(degrees), np.array(shapes)
    closed = np.array([outline.closed for outline in table.parts])
    control_points = host["points"][control] * host["sizes"][shape][:, None, :]
    with np.errstate(over="ignore", invalid="ignore"):  # points so far away are refused, but by the caller
        bend = np.abs(np.diff(control_points, n=2, axis=1))  # of a line or a quadratic curve only the first counts
        bend = np.hypot(bend[..., 0], bend[..., 1]) * np.stack([degree >= 2, degree == 3], axis=1)
        chord_count = np.sqrt(degree * (degree - 1) * bend.max(axis=1) / (8.0 * TOLERANCE))
    counts = np.clip(np.ceil(np.where(np.isfinite(chord_count), chord_count, 1.0)), 1, MOST_CHORDS).astype(np.int64)
    samples = counts.copy()
    samples[np.array(stops) - 1] += ~closed  # the end of an open outline
    row, index = ragged_arange(samples)
    time = index / counts[row]
    weights = torch.as_tensor(_bernstein(degree[row], time), device=device)
    scaled = torch.zeros((len(row), 2), dtype=torch.float64, device=device)
    for number in range(4):
        control_row = torch.as_tensor(control[row, number], device=device)
        scaled = scaled + weights[:, number, None] * scene["points"].index_select(0, control_row)
    owner = shape[row]
    local = scaled * scene["sizes"].index_select(0, torch.as_tensor(owner, device=device))
    stops = np.cumsum(samples)[np.array(stops) - 1]
    rings = [
        Ring(outline.shape, int(first), int(stop), outline.closed)
        for outline, first, stop in zip(table.parts, [0, *stops[:-1]], stops, strict=True)
    ]
    corner = (index == 0) | (index == counts[row])
    return local, owner, corner, rings


def _bernstein(degree: IndexArray, time: FloatArray) -> FloatArray:
    """Weights of the control points of curves at `time`, shape (m, 4); those past the degree are 0."""
    remainder = 1.0 - time
    none = np.zeros_like(time)
    line = [remainder, time, none, none]
    quadratic = [remainder**2, 2.0 * remainder * time, time**2, none]
    cubic = [remainder**3, 3.0 * remainder**2 * time, 3.0 * remainder * time**2, time**3]
    kinds = np.array([line, quadratic, cubic])
    return np.ascontiguousarray(kinds[degree - 1, :, np.arange(len(time))])


def _device(scene: Tensors) -> torch.device:
    return scene["sizes"].device

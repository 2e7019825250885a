"""Ten warps of pictures and textures, and ten drawings on photographs, half of them SVG."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from examples.convergence.case import Case, Trial, photograph
from loi_core import Free
from loi_core.pixels.encoding import decode_srgb
from loi_core.renderers import Warp
from loi_core.support.arrays import Host, from_numpy, to_numpy
from loi_torch.vector import Circle, Ellipse, Paint, Rectangle, Shape, Vector, polygon, write_svg

__all__ = ["VECTORS", "WARPS"]

HEIGHT, WIDTH = 96, 128
MARGIN_PX: Final = 14.0
MIN_DISTANCE_PX: Final = 25.0  # from start to goal

POSES: Final = (("rotation", 0.0, 60.0, 3.0), ("scale", 1.0, 0.35, 0.03), ("exposure", 0.0, 0.6, 0.1))
"""Name, start, distance of the bounds, and tolerance."""

Random = np.random.Generator


def plain(rng: Random) -> Host:
    """Return one grey."""
    return np.full((HEIGHT, WIDTH, 3), rng.uniform(0.3, 0.6))


def wood(rng: Random) -> Host:
    """Return wood of low contrast with two frequencies."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    grain = 0.45 + 0.075 * np.sin(x / 6 + 2 * np.sin(y / 25) + rng.uniform(0, 6)) + 0.045 * np.sin(y / 3)
    floor: Host = np.clip(grain[..., None] * np.array([1.0, 0.75, 0.5]), 0.0, 1.0)
    return floor


def checkers(rng: Random) -> Host:
    """Return squares of twelve pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    a, b = rng.integers(0, 12, 2)
    return np.repeat(np.where(((x + a) // 12 + (y + b) // 12) % 2 == 0, 0.25, 0.75)[..., None], 3, axis=-1)


def noise(rng: Random) -> Host:
    """Return independent noise."""
    return np.clip(0.5 + 0.15 * rng.standard_normal((HEIGHT, WIDTH, 3)), 0.0, 1.0)


def picture(rng: Random) -> Host:
    """Return a crop of a photograph."""
    return photograph(HEIGHT, WIDTH, rng)


def ball(rng: Random) -> Host:
    """Return a shaded disk with an edge of one pixel, and its opacity."""
    y, x = np.mgrid[-10:11, -10:11]
    distance = np.hypot(x, y)
    shade = 0.25 + 0.75 * np.sqrt(np.clip(1.0 - (distance / 9.0) ** 2, 0.0, 1.0))
    colour = rng.uniform(0.1, 1.0, 3)
    return np.concatenate([shade[..., None] * colour, np.clip(9.5 - distance, 0.0, 1.0)[..., None]], axis=-1)


def patch(rng: Random) -> Host:
    """Return a square crop of a photograph."""
    return photograph(24, 24, rng)


def _start_and_goal(rng: Random) -> tuple[Host, Host]:
    """Return a start and a goal, far from each other and from the border, in pixels from the image's corner."""
    size = np.array([WIDTH, HEIGHT])
    while True:
        start, goal = rng.uniform(MARGIN_PX, size - MARGIN_PX), rng.uniform(MARGIN_PX, size - MARGIN_PX)
        if float(np.hypot(*(start - goal))) >= MIN_DISTANCE_PX:
            return start, goal


def _warp(background: Callable[[Random], Host], front: Callable[[Random], Host], pose: str, seed: int) -> Trial:
    rng = np.random.default_rng(seed)
    renderer = Warp(front(rng), background(rng))
    start, goal = (position - np.array([WIDTH, HEIGHT]) / 2 for position in _start_and_goal(rng))
    lower = np.array([MARGIN_PX - WIDTH / 2, MARGIN_PX - HEIGHT / 2])
    free, goals, allowed = {"translation": Free(start, lower, -lower)}, {"translation": goal}, {"translation": 1.0}
    for name, first, span, tolerance in POSES:
        if name in pose:
            goals[name] = np.asarray(first + rng.uniform(-0.7, 0.7) * span)
            free[name], allowed[name] = Free(first, first - span, first + span), tolerance
    return Trial(renderer, renderer.render(renderer.parameters() | goals), free, goals, allowed)


def _vector(shape: str, as_svg: bool, seed: int) -> Trial:  # noqa: FBT001  # by functools.partial
    rng = np.random.default_rng([seed, as_svg])
    size = np.array([WIDTH, HEIGHT])
    start, goal = _start_and_goal(rng)
    paint = Paint(fill=(*rng.uniform(0.0, 1.0, 3), 1.0))
    angles, radii = np.arange(10) * np.pi / 5, np.where(np.arange(10) % 2, 4.0, 9.0)
    star = start + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)
    shapes: dict[str, Callable[[], Shape]] = {
        "circle": lambda: Circle(start, 8.0, paint),
        "ellipse": lambda: Ellipse(start, (12.0, 6.0), paint, rotation=rng.uniform(0, 180)),
        "square": lambda: Rectangle(start, (9.0, 9.0), paint, rotation=rng.uniform(0, 90)),
        "star": lambda: polygon(star, paint),
        "ring": lambda: Circle(start, 9.0, Paint(stroke=(*rng.uniform(0.0, 1.0, 3), 1.0), width=5.0)),
    }
    drawn_shape, background = shapes[shape](), decode_srgb(photograph(HEIGHT, WIDTH, rng))
    if as_svg:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "shape.svg"
            write_svg(file, [drawn_shape], HEIGHT, WIDTH)
            renderer = Vector(HEIGHT, WIDTH, svg=file, background=background, encoding="sRGB")
    else:
        renderer = Vector(HEIGHT, WIDTH, [drawn_shape], background, encoding="sRGB")
    start_positions = to_numpy(renderer.parameters()["positions"]).copy()
    goal_positions, lower, upper = start_positions.copy(), start_positions.copy(), start_positions.copy()
    goal_positions[-1] = goal
    lower[-1], upper[-1] = MARGIN_PX, size - MARGIN_PX
    start_positions[-1] = np.clip(start_positions[-1], lower[-1], upper[-1])
    params = renderer.parameters()
    target = to_numpy(renderer.render(params | {"positions": from_numpy(goal_positions, params["positions"])}))
    return Trial(
        renderer,
        target,
        {"positions": Free(start_positions, lower, upper)},
        {"positions": goal_positions},
        {"positions": 1.0},
    )


WARPS: Final = tuple(
    Case(f"warp: {name}", partial(_warp, background, front, pose))
    for name, background, front, pose in (
        ("ball on grey", plain, ball, ""),
        ("ball on wood", wood, ball, ""),
        ("ball on checkers", checkers, ball, ""),
        ("ball on noise", noise, ball, ""),
        ("ball on a picture", picture, ball, ""),
        ("picture on grey, turned", plain, patch, "rotation"),
        ("picture on wood", wood, patch, ""),
        ("picture on checkers", checkers, patch, ""),
        ("picture on noise, scaled", noise, patch, "scale"),
        ("ball on wood, darker", wood, ball, "exposure"),
    )
)

VECTORS: Final = tuple(
    Case(f"{'SVG' if as_svg else 'vector'}: {shape} on a photograph", partial(_vector, shape, as_svg))
    for as_svg in (False, True)
    for shape in ("circle", "ellipse", "square", "star", "ring")
)

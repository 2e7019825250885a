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
MARGIN: Final = 14.0
FAR: Final = 25.0  # pixels at least from start to goal

POSES: Final = (("rotation", 0.0, 60.0, 3.0), ("scale", 1.0, 0.35, 0.03), ("exposure", 0.0, 0.6, 0.1))
"""Name, start, how far the bounds are from it, and what is allowed."""

Random = np.random.Generator


def plain(rng: Random) -> Host:
    """One grey."""
    return np.full((HEIGHT, WIDTH, 3), rng.uniform(0.3, 0.6))


def wood(rng: Random) -> Host:
    """Low contrast, two frequencies."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    grain = 0.45 + 0.075 * np.sin(x / 6 + 2 * np.sin(y / 25) + rng.uniform(0, 6)) + 0.045 * np.sin(y / 3)
    floor: Host = np.clip(grain[..., None] * np.array([1.0, 0.75, 0.5]), 0.0, 1.0)
    return floor


def checkers(rng: Random) -> Host:
    """Squares of twelve pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    a, b = rng.integers(0, 12, 2)
    return np.repeat(np.where(((x + a) // 12 + (y + b) // 12) % 2 == 0, 0.25, 0.75)[..., None], 3, axis=-1)


def noise(rng: Random) -> Host:
    """Every pixel for itself."""
    return np.clip(0.5 + 0.15 * rng.standard_normal((HEIGHT, WIDTH, 3)), 0.0, 1.0)


def picture(rng: Random) -> Host:
    """Part of a photograph."""
    return photograph(HEIGHT, WIDTH, rng)


def ball(rng: Random) -> Host:
    """A shaded disk with an edge of one pixel, and its opacity."""
    y, x = np.mgrid[-10:11, -10:11]
    away = np.hypot(x, y)
    shade = 0.25 + 0.75 * np.sqrt(np.clip(1.0 - (away / 9.0) ** 2, 0.0, 1.0))
    colour = rng.uniform(0.1, 1.0, 3)
    return np.concatenate([shade[..., None] * colour, np.clip(9.5 - away, 0.0, 1.0)[..., None]], axis=-1)


def patch(rng: Random) -> Host:
    """A square of a photograph."""
    return photograph(24, 24, rng)


def _places(rng: Random) -> tuple[Host, Host]:
    """A start and a goal, far from each other and from the border; from the image's corner."""
    size = np.array([WIDTH, HEIGHT])
    while True:
        start, goal = rng.uniform(MARGIN, size - MARGIN), rng.uniform(MARGIN, size - MARGIN)
        if float(np.hypot(*(start - goal))) >= FAR:
            return start, goal


def _warp(background: Callable[[Random], Host], front: Callable[[Random], Host], pose: str, seed: int) -> Trial:
    rng = np.random.default_rng(seed)
    renderer = Warp(front(rng), background(rng))
    start, goal = (place - np.array([WIDTH, HEIGHT]) / 2 for place in _places(rng))
    low = np.array([MARGIN - WIDTH / 2, MARGIN - HEIGHT / 2])
    free, wanted, allowed = {"translation": Free(start, low, -low)}, {"translation": goal}, {"translation": 1.0}
    for name, first, span, off in POSES:
        if name in pose:
            wanted[name] = np.asarray(first + rng.uniform(-0.7, 0.7) * span)
            free[name], allowed[name] = Free(first, first - span, first + span), off
    return Trial(renderer, renderer.render(renderer.parameters() | wanted), free, wanted, allowed)


def _vector(shape: str, as_svg: bool, seed: int) -> Trial:  # noqa: FBT001  # by functools.partial
    rng = np.random.default_rng([seed, as_svg])
    size = np.array([WIDTH, HEIGHT])
    start, goal = _places(rng)
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
    drawn, behind = shapes[shape](), decode_srgb(photograph(HEIGHT, WIDTH, rng))
    if as_svg:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "shape.svg"
            write_svg(file, [drawn], HEIGHT, WIDTH)
            renderer = Vector(HEIGHT, WIDTH, svg=file, background=behind, encoding="sRGB")
    else:
        renderer = Vector(HEIGHT, WIDTH, [drawn], behind, encoding="sRGB")
    own = to_numpy(renderer.parameters()["positions"]).copy()
    wanted, low, high = own.copy(), own.copy(), own.copy()
    wanted[-1] = goal
    low[-1], high[-1] = MARGIN, size - MARGIN
    own[-1] = np.clip(own[-1], low[-1], high[-1])
    params = renderer.parameters()
    target = to_numpy(renderer.render(params | {"positions": from_numpy(wanted, params["positions"])}))
    return Trial(renderer, target, {"positions": Free(own, low, high)}, {"positions": wanted}, {"positions": 1.0})


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

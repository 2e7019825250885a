"""The single shapes of diffvg's examples, drawn by the library's vector renderer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from examples.external.methods import descend
from examples.external.problem import Answer, Method, Problem, Start, Task
from loi_core import PixelL2
from loi_core.fitting.parameters import Free
from loi_core.support.arrays import to_numpy
from loi_torch.vector import Circle, Paint, Rectangle, Shape, Vector

__all__ = ["SHAPES"]

SIDE_PX: Final = 256
GOAL_COLOUR: Final = (0.3, 0.6, 0.3, 1.0)
AUTHORS_STEPS: Final = 100
AUTHORS_RATE: Final = 0.01  # of the side, and of full intensity
MARGIN_PX: Final = 30.0
MIN_SIZE_PX: Final = 4.0
SIZES_PX: Final = (10.0, 60.0)  # of random starts: radii, or half the sides


@dataclass(frozen=True)
class _Frame:
    """Centre, half extents and colour of a shape."""

    centre: tuple[float, float]
    half: tuple[float, float]
    colour: tuple[float, ...]

    def shape(self, shape_name: str) -> Shape:
        """Return the circle or rectangle."""
        paint = Paint(fill=self.colour)
        if shape_name == "circle":
            return Circle(self.centre, self.half[0], paint)
        return Rectangle(self.centre, (2.0 * self.half[0], 2.0 * self.half[1]), paint)


GOALS: Final = {
    "circle": _Frame((128.0, 128.0), (40.0, 40.0), GOAL_COLOUR),
    "rectangle": _Frame((100.0, 100.0), (60.0, 60.0), GOAL_COLOUR),
}
STARTS: Final = {
    "circle": _Frame((108.0, 138.0), (20.0, 20.0), (0.3, 0.2, 0.8, 1.0)),
    "rectangle": _Frame((90.0, 40.0), (10.0, 20.0), (0.3, 0.2, 0.5, 1.0)),
}
"""Goals and starts of diffvg's ``single_circle.py`` and ``single_rect.py``."""


def _make(shape_name: str, seed: int) -> Start:
    """Return the start of the authors for seed 0, and a random one for the other seeds."""
    first, goal = STARTS[shape_name], GOALS[shape_name]
    if seed:
        rng = np.random.default_rng(seed)
        half = rng.uniform(*SIZES_PX, 2)
        centre = rng.uniform(MARGIN_PX, SIDE_PX - MARGIN_PX, 2)
        colour = (*rng.uniform(0.0, 1.0, 3).tolist(), 1.0)
        first = _Frame((centre[0], centre[1]), (half[0], half[0] if shape_name == "circle" else half[1]), colour)
    renderer = Vector(SIDE_PX, SIDE_PX, [first.shape(shape_name)], (0.0, 0.0, 0.0))
    params = renderer.parameters()
    solved = Vector(SIDE_PX, SIDE_PX, [goal.shape(shape_name)], (0.0, 0.0, 0.0))
    target = to_numpy(solved.render(solved.parameters()))
    free = {
        "positions": Free(to_numpy(params["positions"]), 0.0, float(SIDE_PX)),
        "sizes": Free(to_numpy(params["sizes"]), MIN_SIZE_PX, 0.5 * SIDE_PX),
        "fills": Free(to_numpy(params["fills"]), [0.0, 0.0, 0.0, 1.0], 1.0),
    }
    return Start(renderer, target, free, partial(_edge_error, goal))


def _edge_error(goal: _Frame, params: Mapping[str, Any]) -> float:
    """Return the largest distance, in pixels, between an edge of the shape's box and its goal."""
    centre, half = (np.asarray(to_numpy(params[name]), dtype=np.float64)[0] for name in ("positions", "sizes"))
    edges = np.concatenate([centre - half, centre + half])
    expected = np.concatenate([np.subtract(goal.centre, goal.half), np.add(goal.centre, goal.half)])
    return float(np.max(np.abs(edges - expected)))


def _authors_loop(task: Task) -> Answer:
    """Compare pixels at the authors' rate, for their number of steps, without a decay."""
    units = {"positions": float(SIDE_PX), "sizes": float(SIDE_PX), "fills": 1.0}
    free = {name: replace(entry, learning_rate=AUTHORS_RATE * units[name]) for name, entry in task.start.free.items()}
    return descend(PixelL2(task.start.target), task, AUTHORS_STEPS, free=free, decay="none")


SHAPES: Final = tuple(
    Problem(
        f"diffvg's {shape_name}",
        partial(_make, shape_name),
        "px",
        1.0,
        steps=AUTHORS_STEPS,
        renders=250,
        starts=4,
        source="BachiLi/diffvg, apps/single_circle.py and apps/single_rect.py",
        licence="Apache-2.0; numbers alone are taken",
        methods=(Method("diffvg's loop", _authors_loop),),
    )
    for shape_name in GOALS
)

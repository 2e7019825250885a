"""Three disks on plain grey, from afar, against a photograph that is darker than the render."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from examples.external.problem import Problem, Start
from loi_core import Free
from loi_core.renderers import Disks
from loi_core.support.arrays import Host, to_numpy

__all__ = ["DISKS", "disks_at"]

HEIGHT_PX: Final = 64
WIDTH_PX: Final = 80
RADII_PX: Final = (7.0, 6.0, 5.0)
COLOURS: Final = ((0.9, 0.6, 0.2), (0.2, 0.7, 0.9), (0.8, 0.3, 0.6))
GROUND: Final = (0.35, 0.35, 0.35)
DISTANCES_PX: Final = (12.0, 45.0)  # from the start of a disk to its goal
PHOTOGRAPHS: Final = {"x 1": (1.0, 0.0), "x 0.97": (0.97, 0.0), "x 0.9": (0.9, 0.0), "x 0.7 + 0.2": (0.7, 0.2)}
"""Gain and offset of the photograph, by name."""


def disks_at(distances: tuple[float, float], gain: float, offset: float, seed: int) -> Start:
    """Return a start with every disk at a distance in this range, in pixels, from its goal."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(*distances, 3)
    while True:  # the distances stay, as redrawn ones would be shorter
        goals, angles = rng.uniform(_margins(), _frame() - _margins()), rng.uniform(0.0, 2.0 * np.pi, 3)
        starts = goals + lengths[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        if _apart(goals) and np.all((starts >= _margins()) & (starts <= _frame() - _margins())):
            break
    renderer = Disks(HEIGHT_PX, WIDTH_PX, starts, RADII_PX, COLOURS, GROUND)
    target = gain * renderer.render(renderer.parameters() | {"positions": goals}) + offset
    free = {"positions": Free(starts, np.zeros_like(starts), np.broadcast_to(_frame(), starts.shape))}
    return Start(renderer, target, free, partial(_distance, goals))


def _frame() -> Host:
    return np.array([WIDTH_PX, HEIGHT_PX], dtype=np.float64)


def _margins() -> Host:
    return np.array(RADII_PX)[:, None] * np.ones(2)


def _apart(centres: Host) -> bool:
    """Return whether no two disks touch."""
    return all(
        np.hypot(*(centres[first] - centres[second])) > RADII_PX[first] + RADII_PX[second]
        for first in range(3)
        for second in range(first)
    )


def _distance(goals: Host, params: Mapping[str, Any]) -> float:
    return float(np.max(np.hypot(*(np.asarray(to_numpy(params["positions"])) - goals).T)))


DISKS: Final = tuple(
    Problem(
        f"three disks {name}",
        partial(disks_at, DISTANCES_PX, gain, offset),
        "px",
        1.0,
        steps=120,
        renders=300,
        starts=8,
        source="a user of the library",
        licence="none needed",
        quick=name in ("x 1", "x 0.9"),
    )
    for name, (gain, offset) in PHOTOGRAPHS.items()
)

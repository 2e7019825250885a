"""A scene that is fitted quickly, and the simplest renderer, for the tests of fits."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import Disks

TARGET = np.array([[22.0, 9.0]])
START = np.array([[8.0, 23.0]])
SCENE = Disks(32, 32, TARGET, 5.0, [[0.9, 0.6, 0.1]], confine=True)
REFERENCE = SCENE.render(SCENE.parameters())
SCALES = ScaleSpace(1, (3, 9), 0.125)


class Bowl:
    """The simplest renderer of all: its image is its parameter, in any array library."""

    def __init__(self, xp: Any = np) -> None:
        self.xp = xp
        self.start = xp.zeros((2, 2, 1), dtype=xp.float64)

    def parameters(self) -> dict[str, Any]:
        return {"pixels": self.xp.asarray(self.start, copy=True), "unused": self.xp.zeros((), dtype=self.xp.float64)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return params["pixels"], lambda g: {"pixels": g, "unused": self.xp.zeros((), dtype=self.xp.float64)}


def run(steps: int = 60, **options: Any) -> Any:
    free = {"positions": Free(START, 0.0, 32.0)}
    arguments: dict[str, Any] = {"steps": steps, "learning_rate": 1.5, "optimise": free} | options
    return fit(SCENE, LOIObjective(REFERENCE, SCALES), **arguments)


def bad_pullback(gradient: Any) -> Bowl:
    class Bad(Bowl):
        def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
            return params["pixels"], lambda g: gradient

    return Bad()

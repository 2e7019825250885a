"""Problems of others: scenes with a start, a target, and an error in pixels or degrees."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from examples.convergence.case import Case, within
from loi_core import Free, Renderer
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, to_numpy

__all__ = ["Answer", "Method", "Missing", "Problem", "Start", "Task", "needs", "problem_of_case"]

ParameterError: TypeAlias = Callable[[Mapping[str, Any]], float]
"""Returns the error of parameters, in the unit of the problem."""

Missing: TypeAlias = Callable[[], str]
"""Returns the reason why a problem or method cannot run here; empty if it can."""


def nothing_missing() -> str:
    """Return no reason: everything is there."""
    return ""


def needs(*packages: str) -> Missing:
    """Return a function that names the packages, by their import names, that are not installed."""

    def missing() -> str:
        absent = [name for name in packages if importlib.util.find_spec(name) is None]
        return f"needs {', '.join(absent)}" if absent else ""

    return missing


@dataclass(frozen=True)
class Start:
    """A scene with a start and a target.

    Attributes
    ----------
    renderer : Renderer
    target : array, shape (H, W, 3)
    free : dict of Free
        Starts and bounds.
    error : callable
        Error of parameters, in the unit of the problem.
    moving : array, shape (H, W, 3), optional
        The photograph that the renderer moves onto the target, where a scene registers two photographs.
    """

    renderer: Renderer
    target: Host
    free: Mapping[str, Free]
    error: ParameterError
    moving: Host | None = None

    @property
    def distance(self) -> float:
        """The error of the start."""
        return self.error(self.first)

    @property
    def first(self) -> dict[str, Host]:
        """The initial values of the free parameters."""
        return {name: np.asarray(free.initial, dtype=np.float64) for name, free in self.free.items()}


@dataclass(frozen=True)
class Answer:
    """The result of a method: parameters, and the verdict of the library if the method has one."""

    params: Mapping[str, Any]
    verdict: str = ""
    ok: bool | None = None
    renders: int | None = None
    """Number of images, for a method that does not render through the problem's renderer."""


@dataclass(frozen=True)
class Task:
    """One start of one problem, as a method gets it."""

    problem: Problem
    start: Start
    renderer: Renderer
    """The renderer of the start, which counts its images."""
    spent: Callable[[], bool]
    """Whether all images of the budget have been rendered."""
    seed: int


@dataclass(frozen=True)
class Method:
    """A way to minimise, by name."""

    name: str
    minimise: Callable[[Task], Answer]
    missing: Missing = nothing_missing


@dataclass(frozen=True)
class Problem:
    """A named problem of others.

    Attributes
    ----------
    name : str
    make : callable
        Returns the start for a seed.
    unit : {"px", "degrees", "tolerances"}
        Unit of the error.
    tolerance : float
        Largest error of a solved start.
    steps : int
        Steps of the library's fit.
    renders : int
        Budget of images for every method.
    starts : int
        Number of starts; their seeds count from 0.
    source, licence : str
        Author of the test, and the licence of the files and numbers that it needs.
    missing : callable
        Names the packages that the problem lacks.
    methods : tuple of Method
        Methods for this problem alone, such as its authors' loop.
    quick : bool
        Whether the quick tier includes the problem.
    """

    name: str
    make: Callable[[int], Start]
    unit: str
    tolerance: float
    steps: int
    renders: int
    starts: int
    source: str
    licence: str
    missing: Missing = nothing_missing
    methods: tuple[Method, ...] = ()
    quick: bool = False


def problem_of_case(case: Case, *, steps: int = 200, renders: int = 500, starts: int = 3) -> Problem:
    """Return a scene of the convergence suite as a problem; its errors are in tolerances."""

    def make(seed: int) -> Start:
        trial = case.make(seed)

        def error(params: Mapping[str, Any]) -> float:
            return within(trial, params)[1]

        return Start(trial.renderer, trial.target, trial.free, error)

    return Problem(case.name, make, "tolerances", 1.0, steps, renders, starts, "examples.convergence", "Apache-2.0")


def corner_error(size: tuple[int, int], goal: Parameters, params: Mapping[str, Any]) -> float:
    """Return the largest distance, in pixels, between the corners of a picture at two poses of a :class:`Warp`."""
    corners = 0.5 * np.array([[x * size[1], y * size[0]] for x in (-1, 1) for y in (-1, 1)])
    moved, expected = (_posed(corners, pose) for pose in (params, goal))
    return float(np.max(np.hypot(*(moved - expected).T)))


def _posed(points: Host, pose: Mapping[str, Any]) -> Host:
    defaults = {"rotation": 0.0, "scale": 1.0}
    angle, scale = (float(to_numpy(pose[name])) if name in pose else default for name, default in defaults.items())
    cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    placed: Host = scale * points @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(to_numpy(pose["translation"]))
    return placed


def bound_error(function: Callable[..., float], *arguments: Any) -> ParameterError:
    """Return an error function of parameters alone."""
    return partial(function, *arguments)

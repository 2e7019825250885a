"""Measurement of all settings on all backends, and of the renderer's noise."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from loi_core.errors import BackendNotFoundError, OptionError
from loi_core.method.scales import ScaleSpace
from loi_core.objectives import LOIObjective
from loi_core.plugins.registry import BACKENDS
from loi_core.scenes.reading import load_scene
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host
from loi_core.support.guards import is_ctrl_c
from loi_core.support.wording import described
from loi_core.tradeoff.choice import Recommendation, pareto_set, recommend
from loi_core.tradeoff.noise import Noise, ParameterErrors, is_stochastic, renderer_noise
from loi_core.tradeoff.rows import Row, measure_setting
from loi_core.tradeoff.settings import Setting, settings_of

__all__ = ["Missing", "Problem", "Progress", "Tradeoff", "measure"]

Progress: TypeAlias = Callable[[int, str], None]
"""Called as ``progress(total, description)`` before each of `total` measurements."""


@dataclass(frozen=True)
class Problem:
    """The images to compare.

    Attributes
    ----------
    name : str
        For the report.
    image, reference : array, shape (H, W, C), float64
        Images after the tone curve, if the scene has one.
    scales : ScaleSpace
    scene : Scene or None
        Source of a rendered image.
    """

    name: str
    image: Host
    reference: Host
    scales: ScaleSpace
    scene: Scene | None = None


@dataclass(frozen=True)
class Missing:
    """A backend that could not be measured, the reason, and the command that fixes it."""

    name: str
    problem: str
    fix: str = ""


@dataclass(frozen=True)
class Tradeoff:
    """The result of a measurement.

    Attributes
    ----------
    problem : Problem
    rows : tuple of Row
        In order of measurement.
    missing : tuple of Missing
        Backends without rows.
    stochastic : bool or None
        Whether the renderer of the scene is stochastic; None without a scene, or if it was not tested.
    noises : tuple of Noise
        Noise of the renderer for several samples per pixel; empty for a deterministic renderer.
    interrupted : bool
        Whether Ctrl-C ended the measurement.
    load : float or None
        Load of the machine in the minute before; None if the system does not report it.
    """

    problem: Problem
    rows: tuple[Row, ...] = ()
    missing: tuple[Missing, ...] = ()
    stochastic: bool | None = None
    noises: tuple[Noise, ...] = ()
    interrupted: bool = False
    load: float | None = None

    @property
    def noise(self) -> Noise | None:
        """Noise of the renderer for the samples per pixel of the scene."""
        samples = self.problem.scene.samples if self.problem.scene else None
        return next((noise for noise in self.noises if noise.samples == samples), None)

    @property
    def pareto(self) -> tuple[bool, ...]:
        """Whether each row is Pareto optimal in time and error."""
        measured = [index for index, row in enumerate(self.rows) if not row.problem]
        marks = pareto_set([(self.rows[index].seconds, self.rows[index].relevant_error) for index in measured])
        optimal = {index for index, mark in zip(measured, marks, strict=True) if mark}
        return tuple(index in optimal for index in range(len(self.rows)))

    @property
    def recommendation(self) -> tuple[Row, Recommendation] | None:
        """The fastest row whose error is allowed, among the rows with all scales."""
        noise = self.noise.least if self.noise else None
        rows = [row for row in self.rows if not row.problem and not row.setting.change]
        choice = recommend([(row.seconds, row.relevant_error) for row in rows], noise)
        return None if choice is None else (rows[choice.index], choice)


def measure(
    problem: Problem, backends: Sequence[str] = (), *, seconds: float = 0.5, progress: Progress | None = None
) -> Tradeoff:
    """Measure all settings on all backends; Ctrl-C returns the measurements so far.

    Parameters
    ----------
    problem : Problem
        The images to compare.
    backends : sequence of str
        Names of the backends; all installed ones by default.
    seconds : float
        Time for repetitions of each setting, after its first run.
    progress : callable, optional
        Called before each measurement.

    Raises
    ------
    BackendNotFoundError
        If a name in `backends` is unknown, or no backend can be measured.
    OptionError
        If the images cannot be compared.
    """
    factories, settings, missing = _plan(problem.scales, backends)
    exact = LOIObjective(problem.reference, problem.scales).value_and_grad(problem.image)[1]
    norm = float(np.linalg.norm(exact))
    if norm == 0.0:
        msg = "`image` has no gradient of the loss, so there is no error to measure; give one that differs"
        raise OptionError(msg)
    meter = _Meter(Tradeoff(problem, missing=missing, load=_load_average()), seconds, progress, len(settings))
    try:
        parameter_errors = meter.measure_scene(exact)
        for setting in settings:
            meter.announce(str(setting))
            row, gradient = measure_setting(
                factories[setting.backend], setting, problem.image, problem.reference, seconds
            )
            if gradient is not None:
                row = replace(
                    row,
                    error=float(np.linalg.norm(gradient - exact)) / norm,
                    parameter_error=parameter_errors.largest(gradient) if parameter_errors else None,
                )
            meter.result = replace(meter.result, rows=(*meter.result.rows, row))
    except KeyboardInterrupt:
        return replace(meter.result, interrupted=True)
    return meter.result


@dataclass
class _Meter:
    result: Tradeoff
    seconds: float
    progress: Progress | None
    total: int

    def announce(self, description: str) -> None:
        if self.progress is not None:
            self.progress(self.total, description)

    def measure_scene(self, exact: Host) -> ParameterErrors | None:
        """Measure the noise of the scene's renderer; return the errors of its parameters."""
        scene = self.result.problem.scene
        if scene is None:
            return None
        self.result = replace(self.result, stochastic=is_stochastic(scene))
        if self.result.stochastic:
            # With independent samples, four times as many halve the noise.
            samples = scene.samples
            counts = [None] if samples is None else sorted({max(1, samples // 4), samples, 4 * samples})
            self.total += len(counts)
            for count in counts:
                self.announce("the renderer" if count is None else f"the renderer, {count} samples per pixel")
                resampled = scene if count == samples else load_scene(scene.path, output=scene.output, samples=count)
                self.result = replace(
                    self.result, noises=(*self.result.noises, renderer_noise(resampled, self.seconds))
                )
        return ParameterErrors(scene, exact)


def _load_average() -> float | None:
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):  # not on Windows, nor in every container
        return None


def _plan(scales: ScaleSpace, names: Sequence[str]) -> tuple[dict[str, str], list[Setting], tuple[Missing, ...]]:
    """Return factories by name, the settings to measure, and the backends that cannot be measured."""
    announced = {info.name: info for info in BACKENDS.available()}
    for name in names:
        if name not in announced:
            BACKENDS.load(name)  # raises the error
    factories, settings, missing = {}, [], []
    for name, info in announced.items():
        if names and name not in names:
            continue
        try:
            dtypes = tuple(BACKENDS.load(name)().dtypes)
            settings += settings_of(name, dtypes, scales)
        except BackendNotFoundError:
            missing.append(Missing(name, info.problem, info.fix))
        except BaseException as error:  # a plugin may raise anything, SystemExit too
            if is_ctrl_c(error):
                raise
            missing.append(Missing(name, described(error)))
        else:
            factories[name] = info.target
    if not factories:
        reasons = "; ".join(f"{backend.name}: {backend.problem}" for backend in missing)
        msg = f"no backend can be measured: {reasons or 'none is installed'}"
        raise BackendNotFoundError(msg)
    return factories, settings, tuple(missing)

"""The whole measurement: every setting on every backend, and the renderer's noise."""

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
from loi_core.tradeoff.noise import Noise, PulledBack, is_stochastic, renderer_noise
from loi_core.tradeoff.rows import Row, measure_setting
from loi_core.tradeoff.settings import Setting, settings_of

__all__ = ["Missing", "Problem", "Progress", "Tradeoff", "measure"]

Progress: TypeAlias = Callable[[int, str], None]
"""Called as ``progress(total, what)`` before each of `total` measurements."""


@dataclass(frozen=True)
class Problem:
    """What is compared.

    Attributes
    ----------
    name : str
        For the report.
    image, reference : array, shape (H, W, C), float64
        After the tone curve, if the scene has one.
    scales : ScaleSpace
    scene : Scene or None
        Where the image comes from, if it is rendered.
    """

    name: str
    image: Host
    reference: Host
    scales: ScaleSpace
    scene: Scene | None = None


@dataclass(frozen=True)
class Missing:
    """A backend that could not be measured, why, and the command that fixes it."""

    name: str
    problem: str
    fix: str = ""


@dataclass(frozen=True)
class Tradeoff:
    """What was measured.

    Attributes
    ----------
    problem : Problem
    rows : tuple of Row
        In the order in which they were measured.
    missing : tuple of Missing
        Backends without rows.
    stochastic : bool or None
        Whether the scene's renderer is; None without a scene, or if it was not reached.
    noises : tuple of Noise
        That of the renderer at several samples per pixel; empty if nothing is random.
    interrupted : bool
        Whether Ctrl-C ended it early.
    load : float or None
        How many processes kept the machine busy in the minute before; None where the system does not tell.
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
        """The renderer's noise at the scene's own samples per pixel."""
        own = self.problem.scene.samples if self.problem.scene else None
        return next((one for one in self.noises if one.samples == own), None)

    @property
    def pareto(self) -> tuple[bool, ...]:
        """For each row whether no other is better in time or error and at least as good in the other."""
        measured = [index for index, row in enumerate(self.rows) if not row.problem]
        marks = pareto_set([(self.rows[index].seconds, self.rows[index].judged) for index in measured])
        marked = {index for index, mark in zip(measured, marks, strict=True) if mark}
        return tuple(index in marked for index in range(len(self.rows)))

    @property
    def recommendation(self) -> tuple[Row, Recommendation] | None:
        """The cheapest row with an error that is small enough, among those that compare all scales."""
        noise = self.noise.least if self.noise else None
        rows = [row for row in self.rows if not row.problem and not row.setting.change]
        found = recommend([(row.seconds, row.judged) for row in rows], noise)
        return None if found is None else (rows[found.index], found)


def measure(
    problem: Problem, backends: Sequence[str] = (), *, seconds: float = 0.5, progress: Progress | None = None
) -> Tradeoff:
    """Measure all settings on all backends; Ctrl-C ends it with what is done.

    Parameters
    ----------
    problem : Problem
        What is compared.
    backends : sequence of str
        Names of those to measure; all that are installed by default.
    seconds : float
        How long each setting is repeated, after it has run once.
    progress : callable, optional
        Called before each measurement.

    Raises
    ------
    BackendNotFoundError
        If `backends` names one that is not there, or none can be measured.
    OptionError
        If the images cannot be compared.
    """
    targets, settings, missing = _plan(problem.scales, backends)
    exact = LOIObjective(problem.reference, problem.scales).value_and_grad(problem.image)[1]
    size = float(np.linalg.norm(exact))
    if size == 0.0:
        msg = "`image` has no gradient of the loss, so there is no error to measure; give one that differs"
        raise OptionError(msg)
    meter = _Meter(Tradeoff(problem, missing=missing, load=_load()), seconds, progress, len(settings))
    try:
        pulled = meter.measure_scene(exact)
        for setting in settings:
            meter.tell(str(setting))
            sample = measure_setting(targets[setting.backend], setting, problem.image, problem.reference, seconds)
            if isinstance(sample, str):
                row = Row(setting, problem=sample)
            else:
                error = float(np.linalg.norm(sample.gradient - exact)) / size
                carried = pulled.error(sample.gradient) if pulled else None
                row = Row(setting, sample.device, sample.seconds, sample.runs, sample.memory, error, carried)
            meter.found = replace(meter.found, rows=(*meter.found.rows, row))
    except KeyboardInterrupt:
        return replace(meter.found, interrupted=True)
    return meter.found


@dataclass
class _Meter:
    found: Tradeoff
    seconds: float
    progress: Progress | None
    total: int

    def tell(self, what: str) -> None:
        if self.progress is not None:
            self.progress(self.total, what)

    def measure_scene(self, exact: Host) -> PulledBack | None:
        """The noise of the scene's renderer, and its pullback for the errors of the rows."""
        scene = self.found.problem.scene
        if scene is None:
            return None
        self.found = replace(self.found, stochastic=is_stochastic(scene))
        if self.found.stochastic:
            # If samples are independent, four times as many halve the noise.
            own = scene.samples
            counts = [None] if own is None else sorted({max(1, own // 4), own, 4 * own})
            self.total += len(counts)
            for count in counts:
                self.tell("the renderer" if count is None else f"the renderer, {count} samples per pixel")
                other = scene if count == own else load_scene(scene.path, output=scene.output, samples=count)
                self.found = replace(self.found, noises=(*self.found.noises, renderer_noise(other, self.seconds)))
        return PulledBack(scene, exact)


def _load() -> float | None:
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):  # not on Windows, nor in every container
        return None


def _plan(scales: ScaleSpace, wanted: Sequence[str]) -> tuple[dict[str, str], list[Setting], tuple[Missing, ...]]:
    """Factories by name, what to measure, and the backends that cannot be."""
    announced = {info.name: info for info in BACKENDS.available()}
    for name in wanted:
        if name not in announced:
            BACKENDS.load(name)  # says so
    targets, settings, missing = {}, [], []
    for name, info in announced.items():
        if wanted and name not in wanted:
            continue
        try:
            dtypes = tuple(BACKENDS.load(name)().dtypes)
            settings += settings_of(name, dtypes, scales)
        except BackendNotFoundError:
            missing.append(Missing(name, info.problem, info.fix))
        except BaseException as error:  # a plugin may raise anything, SystemExit too; the others must go on
            if is_ctrl_c(error):
                raise
            missing.append(Missing(name, described(error)))
        else:
            targets[name] = info.target
    if not targets:
        reasons = "; ".join(f"{one.name}: {one.problem}" for one in missing)
        msg = f"no backend can be measured: {reasons or 'none is installed'}"
        raise BackendNotFoundError(msg)
    return targets, settings, tuple(missing)

"""The library's fit and its rivals: other losses with the same optimiser, and searches without gradients."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from examples.external.problem import Answer, Method, Task, needs
from loi_core import MSSSIM, Free, GaussianPyramid, ImageObjective, LOIObjective, Objective, PixelL2, fit
from loi_core.fitting.loop import Decay
from loi_core.fitting.parameters import Bounds, bounds_of, starting_parameters
from loi_core.objectives import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host, detached, from_numpy, namespace, sum_of_all, to_numpy

__all__ = ["L1DSSIM", "METHODS", "RESTARTS", "descend"]

DSSIM_SHARE: Final = 0.2  # of the loss of 3D Gaussian splatting (Kerbl et al. 2023)
RESERVED_RENDERS: Final = 5  # of a fit, for its verdict and its last image
UNIT_RENDERS: Final = 2  # per free parameter, to measure its rate
RESTARTS: Final = 4
CMA_SIGMA: Final = 0.25  # of the range between the bounds


class L1DSSIM(ImageObjective[str]):
    """The loss of 3D Gaussian splatting: four fifths of the mean difference, and a fifth of 1 - SSIM.

    Parameters
    ----------
    reference : array, shape (H, W, C)
    """

    def __init__(self, reference: Array) -> None:
        super().__init__(reference)
        self._structure = MSSSIM(reference, levels=1)

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        """See :class:`loi_core.ImageObjective`."""
        return _Blend(reference.planes, self._structure.compare_with(reference))


@dataclass(frozen=True, eq=False)
class _Blend(PlaneComparison[str]):
    reference: Array
    structure: PlaneComparison[str]

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[str]:
        xp = namespace(planes)
        difference, factor = planes - self.reference, (1.0 - DSSIM_SHARE) / math.prod(planes.shape)
        structure = self.structure.compare(planes, gradient=gradient)
        terms = {"l1": factor * sum_of_all(xp.abs(difference))}
        terms |= {name: DSSIM_SHARE * term for name, term in structure.terms.items()}
        if structure.gradient is None:
            return Evaluation(terms, None)
        return Evaluation(terms, factor * xp.sign(difference) + DSSIM_SHARE * structure.gradient)


def descend(
    objective: Objective,
    task: Task,
    steps: int,
    *,
    free: Mapping[str, Free] | None = None,
    decay: Decay = "cosine",
) -> Answer:
    """Return the result of a fit of `steps` steps, which ends early when the budget is spent."""
    result = fit(
        task.renderer,
        objective,
        steps=steps,
        seed=1000 * task.seed,
        callback=lambda *_: task.spent(),
        optimise=task.start.free if free is None else free,
        decay=decay,
    )
    diagnosis = result.diagnosis
    if diagnosis is None or not isinstance(objective, LOIObjective):
        return Answer(result.best_params)
    return Answer(result.best_params, diagnosis.verdict, diagnosis.ok)


def _loi(task: Task) -> Answer:
    return descend(LOIObjective(task.start.target), task, task.problem.steps)


def _loi_matched(task: Task) -> Answer:
    exposure: dict[str, Any] = {"exposure": "matched"}
    return descend(LOIObjective(task.start.target, **exposure), task, task.problem.steps)


def _without_matching() -> str:
    return "" if "exposure" in inspect.signature(LOIObjective).parameters else "needs `exposure` of LOIObjective"


def _by_loss(loss: Callable[[Host], Objective]) -> Callable[[Task], Answer]:
    """Return a descent of a loss that spends the whole budget."""

    def minimise(task: Task) -> Answer:
        return descend(loss(task.start.target), task, max(task.problem.renders - _reserved(task), 1))

    return minimise


def _restarts(task: Task) -> Answer:
    """Descend from the start and from random points, with pixels compared, and return the best end."""
    box, rng = _Box.of(task), np.random.default_rng(task.seed)
    points = [box.start, *rng.random((RESTARTS - 1, box.start.size))]
    objective = PixelL2(task.start.target)
    answers = [_descend_from(box.params(point), objective, task, task.problem.renders // RESTARTS) for point in points]
    return min(answers, key=lambda answer: _value(objective, task, dict(answer.params)))


def _random_search(task: Task) -> Answer:
    """Spend half of the budget on random points, and the rest on a descent from the best, as nvdiffrast's example."""
    box, rng = _Box.of(task), np.random.default_rng(task.seed)
    objective, count = PixelL2(task.start.target), task.problem.renders // 2
    points = [box.start, *rng.random((count - 1, box.start.size))]
    values = [_value(objective, task, box.params(point)) for point in points]
    best = box.params(points[int(np.argmin(values))])
    return _descend_from(best, objective, task, task.problem.renders - count)


def _descend_from(params: Parameters, objective: Objective, task: Task, renders: int) -> Answer:
    """Return the end of a descent that spends this many images."""
    free = {name: Free(params[name], entry.lower, entry.upper) for name, entry in task.start.free.items()}
    return descend(objective, task, max(renders - _reserved(task), 1), free=free)


def _reserved(task: Task) -> int:
    """Return the images that a fit needs beside its steps."""
    return UNIT_RENDERS * len(task.start.free) + RESERVED_RENDERS


def _cma_es(task: Task) -> Answer:
    from cmaes import CMA

    box, objective = _Box.of(task), PixelL2(task.start.target)
    limits = np.tile([0.0, 1.0], (box.start.size, 1))
    search = CMA(mean=box.start, sigma=CMA_SIGMA, bounds=limits, seed=task.seed)
    best, lowest_value = box.start, np.inf
    while not task.spent():
        evaluated = []
        for _ in range(search.population_size):
            if task.spent():
                return Answer(box.params(best))
            point = search.ask()
            value = _value(objective, task, box.params(point))
            evaluated.append((point, value))
            if value < lowest_value:
                best, lowest_value = point, value
        search.tell(evaluated)
    return Answer(box.params(best))


@dataclass(frozen=True)
class _Box:
    """The free numbers of a task as a point of the unit cube."""

    whole: Parameters
    bounds: Bounds
    start: Host

    @classmethod
    def of(cls, task: Task) -> _Box:
        whole = starting_parameters(task.renderer, task.start.free)
        bounds = bounds_of(whole, task.start.free)
        fractions = []
        for name in task.start.free:
            floor, span, movable = _range(bounds, name)
            fractions.append(((to_numpy(whole[name]) - floor) / np.where(movable, span, 1.0))[movable])
        return cls(whole, bounds, np.concatenate(fractions))

    def params(self, point: Host) -> Parameters:
        """Return the parameters at a point of the cube."""
        params, offset = dict(self.whole), 0
        for name in self.bounds.lower:
            floor, span, movable = _range(self.bounds, name)
            count = int(np.sum(movable))
            values = floor.copy()
            values[movable] += point[offset : offset + count] * span[movable]
            params[name] = from_numpy(values, self.whole[name])
            offset += count
        return params


def _range(bounds: Bounds, name: str) -> tuple[Host, Host, Host]:
    """Return the lower bound, the range, and the entries that may move."""
    floor, ceiling = (np.asarray(to_numpy(limit[name]), dtype=np.float64) for limit in (bounds.lower, bounds.upper))
    return floor, ceiling - floor, ceiling > floor


def _value(objective: Objective, task: Task, params: Parameters) -> float:
    return float(detached(objective.value(task.renderer.render(params, seed=task.seed))))


METHODS: Final = (
    Method("loi", _loi),
    Method("loi, matched", _loi_matched, _without_matching),
    Method("pixel L2", _by_loss(PixelL2)),
    Method("L1 + D-SSIM", _by_loss(L1DSSIM)),
    Method("Gaussian pyramid", _by_loss(GaussianPyramid)),
    Method("MS-SSIM", _by_loss(MSSSIM)),
    Method("random restarts", _restarts),
    Method("random search", _random_search),
    Method("CMA-ES", _cma_es, needs("cmaes")),
)
"""Methods for every problem; all but the last three descend with Adam."""

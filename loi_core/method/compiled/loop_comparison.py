"""Planes and a reference, compared by compiled loops: what :mod:`loi_core.method.array_comparison` computes.

Each task is a few levels of one plane. It makes its levels one at a time and carries each all the way, to the cost of
every extent and back, before the next: a handful of planes is all that is at work, whatever the number of levels.
Which levels make a task depends on sizes alone, and sums over tasks have a fixed order, so results do not depend on the
number of threads.
"""

from __future__ import annotations

import functools
import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from loi_core.method.comparison import Compared
from loi_core.method.compiled.arena import Arena
from loi_core.method.compiled.bands import Numbers
from loi_core.method.compiled.inner import InnerBlur
from loi_core.method.compiled.levels import compare_levels
from loi_core.method.compiled.program import Program, Wiring
from loi_core.method.compiled.records import Operators, Results, Tables, Tonal
from loi_core.method.compiled.threads import run_all
from loi_core.method.distance import tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.planner import make_plan
from loi_core.method.sampling_error import Misplaced, Tally
from loi_core.method.scales import ScaleSpace
from loi_core.method.scope import differing_window, levels_among, scope_of
from loi_core.method.tonal import ROOT_TWO, in_levels
from loi_core.pixels.bounds import above_padding

__all__ = ["LoopComparison", "compare_something"]

TASKS: Final = 12  # about as many as there are of a small batch, so that cores find enough to do
FEWEST_LEVELS: Final = 4  # of a task; each makes again what the levels below its own add to the CDF
FEWEST_SAMPLES: Final = 2**15  # of all levels of a task: half a millisecond
SHARED: Final = 2**18  # samples of all levels from which on several threads are worth waiting for each other


def compare_something(dtype: str) -> None:
    """Compare two small images, so that all kernels are compiled for a dtype, or loaded."""
    scales = ScaleSpace(1.0, (0.0, 2.0), 0.5)
    eps = float(np.finfo(dtype).eps)
    plan = make_plan(scales, 4, 4, tolerance=0.0, eps=eps)
    planes = np.linspace(0.0, 1.0, 16, dtype=dtype).reshape(1, 4, 4)
    LoopComparison.of(scales, plan, planes).compare(planes[:, ::-1].copy(), gradient=True)


@dataclass(frozen=True)
class LoopComparison:
    """By compiled loops, for NumPy arrays: the sibling of `loi_core.method.array_comparison.ArrayComparison`."""

    inner: tuple[_InnerComparison, ...]

    @classmethod
    def of(cls, scales: ScaleSpace, plan: Plan, reference: Numbers, weights: Numbers | None = None) -> LoopComparison:
        """Everything that depends on the reference alone: planes within the bounds, and weights, shape (N, H, W)."""
        if weights is None:
            weights = np.zeros((reference.shape[0], 0, 0), reference.dtype)
        return cls(tuple(_InnerComparison.of(scales, inner, plan.tonal, reference, weights) for inner in plan.inner))

    def compare(self, clipped: Numbers, *, gradient: bool) -> Compared:
        """Compare planes within the bounds, shape (N, H, W)."""
        return _compare(self.inner, clipped, gradient=gradient)


def _compare(comparisons: Sequence[_InnerComparison], clipped: Numbers, *, gradient: bool) -> Compared:
    scales, count = comparisons[0].scales, clipped.shape[0]
    groups = -(-TASKS // (count * len(comparisons)))
    above = above_padding(clipped, scales.padding)
    arena = _own_arena(clipped.dtype)
    work: list[list[list[_Task]]] = [[[] for _ in comparisons] for _ in range(count)]

    def look(plane: int, index: int, mine: Arena) -> None:
        work[plane][index] = comparisons[index].tasks(above[plane], plane, groups, mine, gradient=gradient)

    def pull_back(plane: int, mine: Arena) -> None:
        for each, tasks in zip(comparisons, work[plane], strict=True):
            if tasks:
                cotangent = functools.reduce(np.add, (task.cotangent for task in tasks))
                total[plane] += each.blur.adjoint(cotangent, mine)

    looks = [functools.partial(look, plane, index) for plane in range(count) for index in range(len(comparisons))]
    shared = None if len(comparisons) * clipped.size >= SHARED else 1
    run_all(looks, arena, most=shared)
    # The widest take longest, so they come first: what is left then is small.
    tasks = [task for index in range(len(comparisons)) for plane in work for task in plane[index]]
    samples = sum((task.levels[2] - task.levels[1]) * task.image.size for task in tasks)
    run_all([task.run for task in tasks], arena, most=None if samples >= SHARED else 1)
    costs = dict.fromkeys(scales.keys, 0.0)
    for task in tasks:
        for extent, cost in zip(task.wiring.plan.extents, task.costs, strict=True):
            costs[extent.alpha, task.beta, task.wiring.plan.sigma] += float(cost)
    terms = {key: np.asarray(cost, clipped.dtype) for key, cost in costs.items()}
    if not gradient:
        return Compared(terms, None)
    total = np.zeros_like(clipped)
    run_all([functools.partial(pull_back, plane) for plane in range(count)], arena, most=shared)
    parts = (
        _misplaced(each, [plane[index] for plane in work], clipped[0].size) for index, each in enumerate(comparisons)
    )
    return Compared(terms, total, tuple(itertools.chain.from_iterable(parts)))


def _misplaced(comparison: _InnerComparison, work: Sequence[list[_Task]], pixels: int) -> Iterator[Misplaced]:
    """What the tasks of one inner scale misplaced, given by plane."""
    extents = comparison.plan.extents
    for beta in comparison.scales.beta:
        tally = Tally(len(work), pixels, np.zeros((len(extents), 2)))
        for tasks in ([task for task in plane if task.beta == beta] for plane in work):
            tally.active += bool(tasks)
            for task in tasks:
                tally.compared += task.levels[2] - task.levels[1]
                tally.sums += task.doubts
        for index, extent in enumerate(extents):
            if extent.is_sampled and tally.compared:
                yield Misplaced.of(tally, index, extent.blur.target.cells, scales=comparison.scales, beta=beta)


@dataclass(frozen=True)
class _TonalScale:
    """One tonal scale, and the reference there."""

    plan: TonalPlan
    host: tuple[float, ...]  # where the levels are, above the padding
    positions: Numbers  # the reference in units of the distance of two levels, shape (N, h, w)
    numbers: Numbers  # those of a Tonal
    weights: Numbers  # and its extents' weights
    slope: float  # of those units by intensity, and of what the loops leave out

    @classmethod
    def of(cls, scales: ScaleSpace, inner: InnerPlan, plan: TonalPlan, intensity: Numbers) -> _TonalScale:
        """That of a reference above the padding, shape (N, h, w)."""
        beta, dtype = plan.beta, intensity.dtype
        positions, width, mass = in_levels(intensity, scales, beta)
        per_sample = scales.scale_weight * scales.level_weight(beta) / intensity.shape[0]
        weights = [per_sample / extent.blur.target.cells for extent in inner.extents]
        peak = math.log(mass / (math.sqrt(2.0 * math.pi) * width))
        # Far tails are cut where they are far below a rounding: products of what is smaller may be slow to compute.
        least = 3.0 * math.log(float(np.finfo(dtype).eps))
        tonal = Tonal(1.0 / (ROOT_TWO * width), peak, least, tie_threshold(intensity, mass), 1.0 / scales.p, weights)
        host = tuple(float(level) - scales.padding for level in scales.levels(beta)[: plan.last])
        slope = ROOT_TWO / width / scales.spacing(beta)
        return cls(plan, host, positions, np.asarray(tonal[:-1], dtype), np.asarray(tonal.weights, dtype), slope)


@dataclass(frozen=True)
class _InnerComparison:
    """One inner scale, its bands, and the reference there; for NumPy arrays."""

    scales: ScaleSpace
    plan: InnerPlan
    tonal: tuple[_TonalScale, ...]
    blur: InnerBlur
    intensity: Numbers  # the reference's, above the padding; shape (N, h, w)
    weights: Numbers  # of its pixels, shape (N, h, w), or (N, 0, 0) if all count alike
    wiring: Wiring

    @classmethod
    def of(
        cls, scales: ScaleSpace, plan: InnerPlan, tonal: tuple[TonalPlan, ...], reference: Numbers, weights: Numbers
    ) -> _InnerComparison:
        """Everything that depends on the reference alone: planes within the bounds, and weights, shape (N, H, W)."""
        blur, arena = InnerBlur.of(plan.blur, reference.dtype), Arena(reference.dtype)
        intensity = np.stack([blur.apply(plane, arena) for plane in above_padding(reference, scales.padding)])
        scale = tuple(_TonalScale.of(scales, plan, each, intensity) for each in tonal)
        return cls(scales, plan, scale, blur, intensity, weights, Wiring.of(plan, reference.dtype))

    def tasks(self, above: Numbers, plane: int, most: int, arena: Arena, *, gradient: bool) -> list[_Task]:
        """What there is to do for a plane of an image, given as what it is above the padding, shape (H, W)."""
        image, reference = self.blur.apply(above, arena), self.intensity[plane]
        differing = differing_window(image[None], reference[None])
        if differing is None:
            return []
        route = self.wiring.route(differing)
        scope = scope_of(differing, route, image[None], reference[None], self.scales, gradient=gradient)
        program = self.wiring.program(scope)
        eps = float(np.finfo(image.dtype).eps)
        tasks = []
        for tonal in self.tonal:
            beta = tonal.plan.beta
            among = levels_among(tonal.host, tonal.plan.first, scope, self.scales, beta, eps)
            count = among.stop - among.first
            if count <= 0:
                continue
            ours, theirs = in_levels(image, self.scales, beta)[0], tonal.positions[plane]
            groups = max(1, min(count // FEWEST_LEVELS, count * image.size // FEWEST_SAMPLES, most))
            edges = [among.first + count * index // groups for index in range(groups + 1)]
            for first, stop in itertools.pairwise(edges):
                levels = among.start, first, stop
                weights = self.weights[plane]
                tasks.append(_Task(beta, ours, theirs, weights, levels, tonal, self.wiring, program, gradient))
        return tasks


@dataclass
class _Task:
    """Some levels of one plane, and, once it has run, what they cost and how that changes with the image."""

    beta: float
    image: Numbers
    reference: Numbers
    weights: Numbers
    levels: tuple[int, int, int]
    tonal: _TonalScale
    wiring: Wiring
    program: Program
    gradient: bool
    costs: Numbers = field(init=False)
    doubts: Numbers = field(init=False)
    cotangent: Numbers = field(init=False)

    def run(self, arena: Arena) -> None:
        """Compute it."""
        self.costs = np.zeros(len(self.wiring.plan.extents))
        self.doubts = np.zeros((len(self.wiring.plan.extents), 2))
        self.cotangent = np.zeros(self.image.shape if self.gradient else (0, 0), self.image.dtype)
        bands, program = self.wiring.bands, self.program
        compare_levels(
            self.image,
            self.reference,
            self.weights,
            np.asarray(self.levels, np.int64),
            self.tonal.numbers,
            self.tonal.weights,
            *Operators(bands.weights, bands.starts, bands.table, arena.of(program.elements)),
            *Tables(program.nodes, program.edges, program.places, self.wiring.samplings),
            *Results(self.costs, self.doubts, self.cotangent, np.zeros(self.wiring.room)),
        )
        self.cotangent *= self.tonal.slope


def _own_arena(dtype: np.dtype[Any]) -> Callable[[], Arena]:
    """What gives each thread an arena of its own, the same one whenever it asks."""
    threads = threading.local()

    def own() -> Arena:
        if not hasattr(threads, "arena"):
            threads.arena = Arena(dtype)
        arena: Arena = threads.arena
        return arena

    return own

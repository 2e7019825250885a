"""An image and a reference at one inner scale, compared by compiled kernels: what :mod:`loi_core.comparison` computes.

Each task is a few levels of one plane. It makes its levels one at a time and carries each all the way, to the cost of
every extent and back, before the next: a handful of planes is all that is at work, whatever the number of levels.
Which levels make a task depends on sizes alone, and sums over tasks have a fixed order, so results do not depend on the
number of threads.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from loi_core.comparison import ScaleKey
from loi_core.compiled.bands import Numbers
from loi_core.compiled.kernels import compare_levels
from loi_core.compiled.program import Program, Wiring
from loi_core.compiled.threads import run_all
from loi_core.distance import tie_threshold
from loi_core.operators import GaussianBlur
from loi_core.plan import InnerPlan, TonalPlan
from loi_core.scales import ScaleSpace
from loi_core.scope import find_scope, levels_among
from loi_core.tonal import ROOT_TWO, above_padding, in_levels

__all__ = ["CompiledComparison", "compare"]

TASKS: Final = 12  # about as many as there are of a small batch, so that cores find enough to do
FEWEST_LEVELS: Final = 4  # of a task; each makes again what the levels below its own add to the CDF
FEWEST_SAMPLES: Final = 2**15  # of all levels of a task: half a millisecond
SHARED: Final = 2**18  # samples of all levels from which on several threads are worth waiting for each other
ALIGNMENT: Final = 64  # bytes of a full vector, and of a line of the cache


def compare(
    comparisons: Sequence[CompiledComparison], clipped: Numbers, *, gradient: bool
) -> tuple[dict[ScaleKey, float], Numbers | None]:
    """The terms of planes within the bounds, shape (N, H, W), and their cotangent by the planes if asked for."""
    groups = -(-TASKS // (clipped.shape[0] * len(comparisons)))
    above = above_padding(clipped, comparisons[0].scales)
    work = [each.tasks(above, groups, gradient=gradient) for each in comparisons]
    tasks = [task for part in work for task in part]
    elements = max((task.program.elements for task in tasks), default=0)
    samples = sum((task.levels[2] - task.levels[1]) * task.image.size for task in tasks)
    run_all(
        [task.run for task in tasks],
        functools.partial(_aligned, elements, clipped.dtype),
        most=None if samples >= SHARED else 1,
    )
    terms = dict.fromkeys(comparisons[0].scales.keys, 0.0)
    for task in tasks:
        for extent, cost in zip(task.wiring.plan.extents, task.costs, strict=True):
            terms[extent.alpha, task.beta, task.wiring.plan.sigma] += float(cost)
    if not gradient:
        return terms, None
    total = np.zeros_like(clipped)
    for each, part in zip(comparisons, work, strict=True):
        cotangent = np.zeros_like(each.intensity)
        for task in part:
            cotangent[task.plane] += task.cotangent
        total += each.blur.adjoint(cotangent)
    return terms, total


@dataclass(frozen=True)
class CompiledComparison:
    """One inner scale, its bands, and the reference there; the counterpart of InnerComparison for NumPy arrays."""

    scales: ScaleSpace
    plan: InnerPlan
    tonal: tuple[TonalPlan, ...]
    blur: GaussianBlur
    intensity: Numbers  # the reference's, above the padding; shape (N, h, w)
    positions: dict[float, Numbers]  # the same in units of the distance of two levels, by tonal scale
    wiring: Wiring

    @classmethod
    def of(
        cls, scales: ScaleSpace, plan: InnerPlan, tonal: tuple[TonalPlan, ...], reference: Numbers
    ) -> CompiledComparison:
        """Everything that depends on the reference alone: planes within the bounds, shape (N, H, W)."""
        blur = GaussianBlur(plan.blur, reference)
        intensity = blur.apply(above_padding(reference, scales))
        positions = {each.beta: np.ascontiguousarray(in_levels(intensity, scales, each.beta)[0]) for each in tonal}
        return cls(scales, plan, tonal, blur, intensity, positions, Wiring.of(plan, reference.dtype))

    def tasks(self, above: Numbers, groups: int, *, gradient: bool) -> list[_Task]:
        """What there is to do for an image, given as what it is above the padding, shape (N, H, W)."""
        intensity: Numbers = self.blur.apply(above)
        return [
            task
            for plane in range(intensity.shape[0])
            for task in self._tasks_of_plane(intensity[plane], plane, groups, gradient=gradient)
        ]

    def _tasks_of_plane(self, image: Numbers, plane: int, most: int, *, gradient: bool) -> Iterator[_Task]:
        reference = self.intensity[plane]
        scope = find_scope(image[None], reference[None], self.plan, self.scales, gradient=gradient)
        if scope is None:
            return
        program = self.wiring.program(scope)
        eps = float(np.finfo(image.dtype).eps)
        for tonal in self.tonal:
            host = [float(level) - self.scales.padding for level in self.scales.levels(tonal.beta)[: tonal.last]]
            among = levels_among(host, tonal.first, scope, self.scales, tonal.beta, eps)
            count = among.stop - among.first
            if count <= 0:
                continue
            ours, width, mass = in_levels(np.ascontiguousarray(image), self.scales, tonal.beta)
            theirs = self.positions[tonal.beta][plane]
            settings = self._settings(tonal.beta, width, mass, image.dtype)
            slope = ROOT_TWO / width / self.scales.spacing(tonal.beta)
            groups = max(1, min(count // FEWEST_LEVELS, count * image.size // FEWEST_SAMPLES, most))
            edges = [among.first + count * index // groups for index in range(groups + 1)]
            for first, stop in itertools.pairwise(edges):
                levels = among.start, first, stop
                yield _Task(plane, tonal.beta, ours, theirs, levels, settings, slope, self.wiring, program, gradient)

    def _settings(self, beta: float, width: float, mass: float, dtype: np.dtype[Any]) -> Numbers:
        """What the kernels have to know of one tonal scale, in units of the distance of two levels."""
        scales = self.scales
        per_sample = scales.scale_weight * scales.level_weight(beta) / self.intensity.shape[0]
        weights = [per_sample / extent.blur.target.cells for extent in self.plan.extents]
        peak = math.log(mass / (math.sqrt(2.0 * math.pi) * width))
        tie = tie_threshold(self.intensity, mass)
        # Far tails are cut where they are far below a rounding: products of what is smaller may be slow to compute.
        least = 3.0 * math.log(float(np.finfo(dtype).eps))
        return np.asarray([1.0 / (ROOT_TWO * width), peak, least, tie, *weights], dtype)


@dataclass
class _Task:
    """Some levels of one plane, and, once it has run, what they cost and how that changes with the image."""

    plane: int
    beta: float
    image: Numbers
    reference: Numbers
    levels: tuple[int, int, int]
    settings: Numbers
    slope: float
    wiring: Wiring
    program: Program
    gradient: bool
    costs: Numbers = field(init=False)
    cotangent: Numbers = field(init=False)

    def run(self, arena: Numbers) -> None:
        """Compute it, with an arena that no other task has at the same time."""
        self.costs = np.zeros(len(self.wiring.plan.extents))
        self.cotangent = np.zeros(self.image.shape if self.gradient else (0, 0), self.image.dtype)
        compare_levels(
            self.image, self.reference, np.asarray(self.levels, np.int64), self.settings, self.wiring.weights,
            self.wiring.starts, self.wiring.table, self.program.nodes, self.program.edges, self.program.places, arena,
            self.costs, self.cotangent,
        )  # fmt: skip
        self.cotangent *= self.slope


def _aligned(elements: int, dtype: np.dtype[Any]) -> Numbers:
    """Zeros that begin where a line of the cache does."""
    spare = ALIGNMENT // dtype.itemsize
    memory = np.zeros(elements + spare, dtype)
    start = -memory.ctypes.data % ALIGNMENT // dtype.itemsize
    return memory[start : start + elements]

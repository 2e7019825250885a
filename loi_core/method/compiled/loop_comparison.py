"""Comparison of planes with a reference by compiled loops: the same as :mod:`loi_core.method.array_comparison`.

Each task is a few tonal levels of one plane. It carries one level at a time all the way, to the cost of every extent
and back, before the next: only a handful of planes is in use, whatever the number of levels. The tasks depend on sizes
alone, and sums over tasks have a fixed order, so results do not depend on the number of threads.
"""

from __future__ import annotations

import functools
import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from loi_core.method.comparison import ComparisonResult
from loi_core.method.compiled.inner import InnerBlur
from loi_core.method.compiled.levels import compare_levels
from loi_core.method.compiled.schedule import Schedule, Scheduler
from loi_core.method.compiled.tables import Floats
from loi_core.method.compiled.threads import run_all
from loi_core.method.compiled.workspace import Workspace
from loi_core.method.distance import tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.planner import make_plan
from loi_core.method.sampling_error import SignErrors, SignErrorSums
from loi_core.method.scales import ScaleSpace
from loi_core.method.support import active_levels, dependency_of, differing_window
from loi_core.method.tonal import ROOT_TWO, to_level_units
from loi_core.pixels.bounds import above_padding

__all__ = ["LoopComparison", "compile_kernels"]

MIN_TASKS: Final = 12  # about as many as a small batch has, so that all cores are busy
MIN_TASK_LEVELS: Final = 4  # each task accumulates again the levels below its own
MIN_TASK_SAMPLES: Final = 2**15  # of all levels of a task: half a millisecond
MIN_SHARED_SAMPLES: Final = 2**18  # of all levels, from which on several threads are faster than one


def compile_kernels(dtype: str) -> None:
    """Compile all kernels for a dtype, or load them, by comparing two small images."""
    scales = ScaleSpace(1.0, (0.0, 2.0), 0.5)
    plan = make_plan(scales, 4, 4, tolerance=0.0, eps=float(np.finfo(dtype).eps))
    planes = np.linspace(0.0, 1.0, 16, dtype=dtype).reshape(1, 4, 4)
    LoopComparison.of(scales, plan, planes).compare(planes[:, ::-1].copy(), gradient=True)


@dataclass(frozen=True)
class LoopComparison:
    """Comparison by compiled loops, for NumPy arrays."""

    inner: tuple[_InnerComparison, ...]

    @classmethod
    def of(cls, scales: ScaleSpace, plan: Plan, reference: Floats, weights: Floats | None = None) -> LoopComparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""
        if weights is None:
            weights = np.zeros((reference.shape[0], 0, 0), reference.dtype)
        return cls(tuple(_InnerComparison.of(scales, inner, plan.tonal, reference, weights) for inner in plan.inner))

    def with_weights(self, weights: Floats) -> LoopComparison:
        """See :class:`loi_core.method.comparison.Comparison`."""
        contiguous = np.array(weights, order="C")  # broadcast arrays would be compiled for again, and are slow
        return LoopComparison(tuple(replace(inner, weights=contiguous) for inner in self.inner))

    def compare(self, compressed: Floats, *, gradient: bool) -> ComparisonResult:
        """Compare planes within the bounds, shape (N, H, W)."""
        scales, count = self.inner[0].scales, compressed.shape[0]
        max_groups = -(-MIN_TASKS // (count * len(self.inner)))
        intensity = above_padding(compressed, scales.padding)
        workspace = _workspace_per_thread(compressed.dtype)
        by_plane: list[list[list[_Task]]] = [[[] for _ in self.inner] for _ in range(count)]

        def prepare(plane: int, index: int, workspace: Workspace) -> None:
            by_plane[plane][index] = self.inner[index].tasks(
                intensity[plane], plane, max_groups, workspace, gradient=gradient
            )

        def pull_back(plane: int, workspace: Workspace) -> None:
            for inner, tasks in zip(self.inner, by_plane[plane], strict=True):
                if tasks:
                    cotangent = functools.reduce(np.add, (task.cotangent for task in tasks))
                    total[plane] += inner.blur.adjoint(cotangent, workspace)

        indices = itertools.product(range(count), range(len(self.inner)))
        max_threads = None if len(self.inner) * compressed.size >= MIN_SHARED_SAMPLES else 1
        run_all(
            [functools.partial(prepare, plane, index) for plane, index in indices], workspace, max_threads=max_threads
        )
        # Inner scales in order: the last, widest blurs have the smallest windows, so that threads end together.
        tasks = [task for index in range(len(self.inner)) for plane in by_plane for task in plane[index]]
        samples = sum(task.compared_levels * task.image.size for task in tasks)
        run_all([task.run for task in tasks], workspace, max_threads=None if samples >= MIN_SHARED_SAMPLES else 1)
        costs = dict.fromkeys(scales.keys, 0.0)
        for task in tasks:
            for extent, cost in zip(task.scheduler.plan.extents, task.costs, strict=True):
                costs[extent.alpha, task.beta, task.scheduler.plan.sigma] += float(cost)
        terms = {key: np.asarray(cost, compressed.dtype) for key, cost in costs.items()}
        if not gradient:
            return ComparisonResult(terms, None)
        total = np.zeros_like(compressed)
        run_all([functools.partial(pull_back, plane) for plane in range(count)], workspace, max_threads=max_threads)
        errors = (
            inner.sign_errors([plane[index] for plane in by_plane], compressed[0].size)
            for index, inner in enumerate(self.inner)
        )
        return ComparisonResult(terms, total, tuple(itertools.chain.from_iterable(errors)))


@dataclass(frozen=True)
class _TonalScale:
    """One tonal scale, and the reference there."""

    plan: TonalPlan
    levels: tuple[float, ...]  # intensities above the padding
    positions: Floats  # the reference in units of the spacing of two levels, shape (N, h, w)
    numbers: Floats  # the scalar fields of `loi_core.method.compiled.tables.TonalScale`
    extent_weights: Floats
    slope: float  # derivative of positions with respect to intensity, and the factor that the kernels leave out

    @classmethod
    def of(cls, scales: ScaleSpace, inner: InnerPlan, plan: TonalPlan, intensity: Floats) -> _TonalScale:
        """Prepare a reference above the padding, shape (N, h, w)."""
        beta, dtype = plan.beta, intensity.dtype
        positions, width, mass = to_level_units(intensity, scales, beta)
        per_plane = scales.scale_weight * scales.level_weight(beta) / intensity.shape[0]
        weights = [per_plane / extent.blur.target.cells for extent in inner.extents]
        log_peak = math.log(mass / (math.sqrt(2.0 * math.pi) * width))
        # The tails end far below a rounding: products of smaller numbers may be subnormal, and slow.
        min_log = 3.0 * math.log(float(np.finfo(dtype).eps))
        numbers = 1.0 / (ROOT_TWO * width), log_peak, min_log, tie_threshold(intensity, mass), 1.0 / scales.p
        levels = tuple(float(level) - scales.padding for level in scales.levels(beta)[: plan.last])
        slope = ROOT_TWO / width / scales.spacing(beta)
        return cls(plan, levels, positions, np.asarray(numbers, dtype), np.asarray(weights, dtype), slope)


@dataclass(frozen=True)
class _InnerComparison:
    """One inner scale, its bands, and the reference there."""

    scales: ScaleSpace
    plan: InnerPlan
    tonal: tuple[_TonalScale, ...]
    blur: InnerBlur
    intensity: Floats  # the reference's, above the padding; shape (N, h, w)
    weights: Floats  # shape (N, h, w), or (N, 0, 0) without weights
    scheduler: Scheduler

    @classmethod
    def of(
        cls, scales: ScaleSpace, plan: InnerPlan, tonal: tuple[TonalPlan, ...], reference: Floats, weights: Floats
    ) -> _InnerComparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""
        blur, workspace = InnerBlur.of(plan.blur, reference.dtype), Workspace(reference.dtype)
        intensity = np.stack([blur.apply(plane, workspace) for plane in above_padding(reference, scales.padding)])
        tonal_scales = tuple(_TonalScale.of(scales, plan, scale, intensity) for scale in tonal)
        scheduler = Scheduler.of(plan, reference.dtype, centred=scales.centred)
        return cls(scales, plan, tonal_scales, blur, intensity, weights, scheduler)

    def tasks(
        self, intensity: Floats, plane: int, max_groups: int, workspace: Workspace, *, gradient: bool
    ) -> list[_Task]:
        """Return the tasks of one plane of an image, whose intensities above the padding have shape (H, W)."""
        image, reference = self.blur.apply(intensity, workspace), self.intensity[plane]
        differing = differing_window(image[None], reference[None], self.scales)
        if differing is None:
            return []
        schedule = self.scheduler.schedule(differing, gradient=gradient)
        dependency = dependency_of(schedule.supports, image[None], reference[None], self.scales, gradient=gradient)
        eps = float(np.finfo(image.dtype).eps)
        tasks = []
        for tonal in self.tonal:
            beta = tonal.plan.beta
            active = active_levels(tonal.levels, tonal.plan.first, dependency, self.scales, beta, eps)
            count = active.stop - active.first
            if count <= 0:
                continue
            planes = to_level_units(image, self.scales, beta)[0], tonal.positions[plane], self.weights[plane]
            groups = max(1, min(count // MIN_TASK_LEVELS, count * image.size // MIN_TASK_SAMPLES, max_groups))
            edges = [active.first + count * index // groups for index in range(groups + 1)]
            tasks += [
                _Task(planes, (active.start, first, stop), tonal, self.scheduler, schedule, gradient)
                for first, stop in itertools.pairwise(edges)
            ]
        return tasks

    def sign_errors(self, by_plane: Sequence[list[_Task]], pixels: int) -> Iterator[SignErrors]:
        """Yield the sign errors of the sampled extents, from the tasks of each plane."""
        extents = self.plan.extents
        for beta in self.scales.beta:
            sums = SignErrorSums(len(by_plane), pixels, np.zeros((len(extents), 2)))
            for tasks in ([task for task in plane if task.beta == beta] for plane in by_plane):
                sums.active_planes += bool(tasks)
                for task in tasks:
                    sums.compared_levels += task.compared_levels
                    sums.by_extent += task.sign_errors
            for index, extent in enumerate(extents):
                if extent.is_sampled and sums.compared_levels:
                    yield SignErrors.of(sums, index, extent.blur.target.cells, scales=self.scales, beta=beta)


@dataclass
class _Task:
    """Some tonal levels of one plane and, after :meth:`run`, their costs and the gradient of the costs."""

    planes: tuple[Floats, Floats, Floats]
    levels: tuple[int, int, int]
    tonal: _TonalScale
    scheduler: Scheduler
    schedule: Schedule
    gradient: bool
    costs: Floats = field(init=False)
    sign_errors: Floats = field(init=False)
    cotangent: Floats = field(init=False)

    @property
    def image(self) -> Floats:
        """The image in units of the spacing of two levels."""
        return self.planes[0]

    @property
    def beta(self) -> float:
        """The tonal scale."""
        return self.tonal.plan.beta

    @property
    def compared_levels(self) -> int:
        """Number of levels that are compared."""
        return self.levels[2] - self.levels[1]

    def run(self, workspace: Workspace) -> None:
        """Compute the results."""
        scheduler, schedule, bands = self.scheduler, self.schedule, self.scheduler.bands
        self.costs = np.zeros(len(scheduler.plan.extents))
        self.sign_errors = np.zeros((len(scheduler.plan.extents), 2))
        self.cotangent = np.zeros(self.image.shape if self.gradient else (0, 0), self.image.dtype)
        compare_levels(
            self.planes,
            self.levels,
            (self.tonal.numbers, self.tonal.extent_weights),
            (bands.weights, bands.starts, bands.table, workspace.of_size(schedule.elements)),
            (schedule.pyramid, schedule.blurs, schedule.offsets, scheduler.spacings),
            (self.costs, self.sign_errors, self.cotangent, np.zeros(scheduler.block_sums_size)),
        )
        self.cotangent *= self.tonal.slope


def _workspace_per_thread(dtype: np.dtype[Any]) -> Callable[[], Workspace]:
    """Return a function that returns the calling thread's workspace."""
    threads = threading.local()

    def workspace() -> Workspace:
        if not hasattr(threads, "workspace"):
            threads.workspace = Workspace(dtype)
        current: Workspace = threads.workspace
        return current

    return workspace

"""The comparison in Triton: few launches, and no CDF at the resolution of the images where the scales allow it.

A comparison is one of two kinds. If every extent passes through a coarser pyramid level or is very narrow, differences
of CDFs are made in registers and blurred down along columns by one kernel, and its adjoint ends in registers too
(*narrow*); a very narrow extent is compared by one kernel from the images to the cotangent. Otherwise a stack of
differences is written, a few levels at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import torch
from torch import Tensor

from loi_core.method.comparison import ComparisonResult, Terms
from loi_core.method.distance import tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.plane_blurs import PlaneBlur
from loi_core.method.planner import make_plan
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import ROOT_TWO
from loi_torch.triton_backend import kernels
from loi_torch.triton_backend.launching import Launcher
from loi_torch.triton_backend.tables import (
    DEPTH,
    TILE,
    WINDOW_ROWS,
    Band,
    Tiles,
    Windows,
    band,
    power_of_two,
    tiles,
    windows,
)

__all__ = ["STACK_BYTES", "TritonComparison"]

STACK_BYTES: Final = 2**26
"""Memory for the stacks of levels that are handled at once, beside some planes."""

MAX_LEVELS: Final = 64  # that are handled at once: `difference_columns` holds them all in registers
LINES: Final = 64
ELEMENTS: Final = 1024  # of a block of an elementwise kernel
STEPS: Final = 8
COLUMNS: Final = 32  # of a tile of `compare_rows`
PULLED_ROWS: Final = 16
LEVEL_ROWS: Final = 128  # levels times rows of a tile of `difference_columns`


@dataclass(frozen=True)
class _Blur:
    """A separable blur of stacks, shape (..., H, W)."""

    plan: PlaneBlur
    run: Launcher

    def rows(self, *, adjoint: bool) -> Band:
        return band(self.plan.rows, self.run.device, adjoint=adjoint)

    def columns(self, *, adjoint: bool) -> Band:
        return band(self.plan.columns, self.run.device, adjoint=adjoint)

    def apply(self, stack: Tensor, *, offset: float = 0.0) -> Tensor:
        """Return the blurred stack; `offset` is subtracted first."""
        if self.plan.columns_first:
            narrow = self.along(stack, self.columns(adjoint=False), -1, offset=offset)
            return self.along(narrow, self.rows(adjoint=False), -2)
        narrow = self.along(stack, self.rows(adjoint=False), -2, offset=offset)
        return self.along(narrow, self.columns(adjoint=False), -1)

    def adjoint(self, stack: Tensor, total: Tensor | None = None, target: Tensor | None = None) -> Tensor:
        """Return the transposed blur of a stack, added to `total` or written to `target`, which may be the stack."""
        if self.plan.columns_first:
            narrow = self.along(stack, self.rows(adjoint=True), -2)
            return self.along(narrow, self.columns(adjoint=True), -1, total, target)
        narrow = self.along(stack, self.columns(adjoint=True), -1)
        return self.along(narrow, self.rows(adjoint=True), -2, total, target)

    def along(
        self,
        stack: Tensor,
        matrix: Band,
        axis: int,
        total: Tensor | None = None,
        target: Tensor | None = None,
        *,
        offset: float = 0.0,
    ) -> Tensor:
        """Multiply one axis of a stack by a matrix; add the product to `total`, or write it to `target`."""
        *outer, height, width = stack.shape
        planes = math.prod(outer)
        if axis == -1:
            lines, shape = height, (*outer, height, matrix.cells)
            strides = (1, width, 1, matrix.cells)
        else:
            lines, shape = width, (*outer, matrix.cells, width)
            strides = (width, 1, width, 1)
        result = total if total is not None else self.run.empty(*shape) if target is None else target
        grid = planes, matrix.blocks, -(-lines // LINES)
        self.run.launch(
            kernels.blur,
            grid,
            stack,
            result,
            matrix.starts,
            matrix.table,
            matrix.size,
            matrix.cells,
            lines,
            matrix.depth,
            *strides,
            offset,
            BLOCK=matrix.block,
            LINES=LINES,
            DEPTH=DEPTH,
            OFFSET=offset != 0.0,
            ADD=total is not None,
            warps=matrix.warps,
            operations=2.0 * planes * lines * matrix.blocks * matrix.block * matrix.depth,
        )
        return result


@dataclass(frozen=True)
class _Extent:
    alpha: float
    start: int
    blur: _Blur
    windows: Windows | None  # if blurred differences can stay in registers
    tiles: tuple[Tiles, Tiles] | None  # of rows and columns, if everything can

    @classmethod
    def of(cls, alpha: float, start: int, blur: _Blur) -> _Extent:
        rows = tiles(blur.plan.rows, blur.run.device) if start == 0 else None
        columns = None if rows is None else tiles(blur.plan.columns, blur.run.device)
        both = None if rows is None or columns is None else (rows, columns)
        return cls(alpha, start, blur, windows(blur.plan.rows, blur.run.device), both)

    @property
    def height(self) -> int:
        return self.blur.plan.rows.target.cells

    @property
    def width(self) -> int:
        return self.blur.plan.columns.target.cells

    @property
    def elements(self) -> int:
        """Elements of a plane of the stacks that its comparison writes."""
        source = self.blur.plan.source
        if self.windows is not None:
            return source.rows.cells * self.width * (1 if self.windows.count == 1 else 2)
        narrow = max(source.rows.cells * self.width, source.columns.cells * self.height)
        return self.height * self.width + (0 if self.blur.plan.is_identity else narrow)

    def programs(self, planes: int) -> int:
        """Return the number of partial sums of costs of a stack of some planes."""
        if self.windows is not None:
            return planes * self.windows.count * -(-self.width // COLUMNS)
        return -(-planes * self.height * self.width // (ELEMENTS * STEPS))


@dataclass(frozen=True)
class _Chunk:
    """Some levels of a tonal scale of some planes, and the arguments that all kernels share."""

    first_level: int
    last_level: int
    image: Tensor
    reference: Tensor
    weights: Tensor | None
    tonal: tuple[float, ...]  # first, per_spacing, count, per_width, peak
    slope_scale: float
    tie: float
    level_weight: float

    @property
    def levels(self) -> int:
        return self.last_level - self.first_level

    @property
    def planes(self) -> int:
        return int(self.image.shape[0])


@dataclass(frozen=True)
class _Inner:
    """One inner scale."""

    scales: ScaleSpace
    plan: InnerPlan
    tonal: tuple[TonalPlan, ...]
    run: Launcher
    reference: Tensor
    reference_intensity: Tensor | None  # kept if there is one inner scale only, for the sake of memory
    weights: Tensor | None
    pyramid: tuple[_Blur, ...]
    extents: tuple[_Extent, ...]  # by pyramid level

    @classmethod
    def of(
        cls,
        scales: ScaleSpace,
        plan: InnerPlan,
        tonal: tuple[TonalPlan, ...],
        run: Launcher,
        reference: Tensor,
        weights: Tensor | None,
        *,
        keep_intensity: bool,
    ) -> _Inner:
        intensity = _intensity(scales, plan, run, reference) if keep_intensity else None
        pyramid = tuple(_Blur(step, run) for step in plan.pyramid)
        extents = (_Extent.of(extent.alpha, extent.start, _Blur(extent.blur, run)) for extent in plan.extents)
        by_level = tuple(sorted(extents, key=lambda extent: extent.start))
        return cls(scales, plan, tonal, run, reference, intensity, weights, pyramid, by_level)

    @property
    def narrow(self) -> bool:
        """Whether no extent needs differences at the resolution of the images."""
        return not self.scales.centred and all(extent.start > 0 or extent.tiles for extent in self.extents)

    @property
    def _chunked(self) -> dict[int, _Extent]:
        """The extents that need a stack of levels, by index."""
        return {index: extent for index, extent in enumerate(self.extents) if not self.narrow or extent.start > 0}

    def compare(self, compressed: Tensor, total: Tensor | None, *, gradient: bool) -> tuple[Terms, Tensor | None]:
        """Return the terms, and the gradient added to `total`, which is overwritten."""
        intensity = _intensity(self.scales, self.plan, self.run, compressed)
        reference = self.reference_intensity
        if reference is None:
            reference = _intensity(self.scales, self.plan, self.run, self.reference)
        chunks = [
            (beta, planes, levels)
            for beta, tonal in enumerate(self.tonal)
            for planes, levels in self._chunks(tonal.first, tonal.last, intensity.shape[0])
        ]
        near = {index: extent for index, extent in enumerate(self.extents) if index not in self._chunked}
        programs = max(
            sum(self._programs(planes, levels) for _, planes, levels in chunks),
            *(intensity.shape[0] * rows.count * columns.count for rows, columns in map(_tiles, near.values())),
            0,
        )
        costs = self.run.empty(len(self.tonal), len(self.extents), programs).zero_()
        self.run.count("zero", costs)
        cotangent = self.run.empty(*intensity.shape) if near and gradient else None
        written: set[int] = set()
        offset = 0
        for beta, tonal in enumerate(self.tonal):
            everything = range(intensity.shape[0]), range(tonal.first, tonal.last)
            for index, extent in near.items():
                chunk = self._chunk(tonal, *everything, intensity, reference)
                self._compare_near(extent, chunk, cotangent, costs[beta, index], add=bool(written))
                written.update(everything[0])
        for beta, planes, levels in chunks:
            chunk = self._chunk(self.tonal[beta], planes, levels, intensity, reference)
            pulled = self._compare(chunk, costs[beta, :, offset:], gradient=gradient)
            offset += self._programs(planes, levels)
            if pulled is None:
                continue
            # Only now, when most of the stacks are gone.
            cotangent = self.run.empty(*intensity.shape) if cotangent is None else cotangent
            cotangent_chunk = cotangent[planes.start : planes.stop]
            self._pull(pulled, chunk, cotangent_chunk, add=planes.start in written)
            written.add(planes.start)
            del pulled
        del intensity, reference, chunk
        sums = costs.sum(-1)
        self.run.count("sum", costs)
        terms = {
            (extent.alpha, tonal.beta, self.plan.sigma): sums[beta, index]
            for beta, tonal in enumerate(self.tonal)
            for index, extent in enumerate(self.extents)
        }
        if cotangent is None:
            return terms, None
        blur = _Blur(self.plan.blur, self.run)
        if not blur.plan.is_identity:
            return terms, blur.adjoint(cotangent, total, cotangent)
        if total is not None:
            self.run.count("add", total, cotangent)
            return terms, total.add_(cotangent)
        return terms, cotangent

    def _chunks(self, first: int, last: int, count: int) -> list[tuple[range, range]]:
        """Return the planes and the levels that are handled at once."""
        if not self._chunked:
            return []
        pixels, columns = self.plan.grid.cells, 0
        if self.narrow:
            columns = 2 * self.plan.grid.rows.cells * self.pyramid[0].plan.columns.target.cells
        level = (columns or 2 * pixels) + max(extent.elements for extent in self._chunked.values())
        level += 2 * sum(step.plan.target.cells for step in self.pyramid)
        stacks = max(1, STACK_BYTES // (4 * level))
        shapes = [
            (planes, min(stacks // planes, last - first, MAX_LEVELS)) for planes in range(1, min(count, stacks) + 1)
        ]
        planes, levels = min(shapes, key=lambda shape: -(-count // shape[0]) * -(-(last - first) // shape[1]))
        groups = -(-(last - first) // levels)
        edges = [first + (last - first) * group // groups for group in range(groups + 1)]
        return [
            (range(plane, min(plane + planes, count)), range(edges[group], edges[group + 1]))
            for plane in range(0, count, planes)
            for group in range(groups)
        ]

    def _programs(self, planes: range, levels: range) -> int:
        """Return the number of partial sums of costs of a chunk."""
        return max(extent.programs(len(planes) * len(levels)) for extent in self._chunked.values())

    def _chunk(
        self,
        tonal: TonalPlan,
        planes: range,
        levels: range,
        intensity: Tensor,
        reference: Tensor,
    ) -> _Chunk:
        scales, beta = self.scales, tonal.beta
        spacing = scales.spacing(beta)
        width, mass = beta / spacing, scales.mass(beta) / spacing
        selected = slice(planes.start, planes.stop)
        return _Chunk(
            levels.start,
            levels.stop,
            intensity[selected],
            reference[selected],
            None if self.weights is None else self.weights[selected],
            (
                float(scales.levels(beta)[0]) - scales.padding,
                1.0 / spacing,
                float(scales.level_count(beta)),
                1.0 / (ROOT_TWO * width),
                math.log(mass / (math.sqrt(2.0 * math.pi) * width)),
            ),
            ROOT_TWO / width / spacing,
            tie_threshold(self.reference, mass),
            scales.scale_weight * scales.level_weight(beta) / intensity.shape[0],
        )

    def _compare(self, chunk: _Chunk, costs: Tensor, *, gradient: bool) -> Tensor | None:
        """Write sums of costs, shape (extents, programs); return the argument of :meth:`_pull`."""
        differences: list[Tensor | None] = [None] if self.narrow else [self._differences(chunk)]
        for index, step in enumerate(self.pyramid):
            if index == 0 and self.narrow:
                stack = step.along(self._narrow_differences(chunk), step.rows(adjoint=False), -2)
            else:
                stack = step.apply(_present(differences[index]))
            differences.append(stack)
            del stack
        cotangents: list[Tensor | None] = [None] * len(differences)
        chunked = self._chunked
        for index, extent in chunked.items():
            start = extent.start
            source = _present(differences[start])
            if not any(later.start == start for later in self.extents[index + 1 :] if not self.narrow or start > 0):
                differences[start] = None
            elif extent.blur.plan.is_identity:
                source = self.run.empty(*source.shape).copy_(source)
                self.run.count("copy", source, source)
            cotangents[start] = self._compare_extent(
                extent, source, costs[index], chunk, cotangents[start], gradient=gradient
            )
            del source
        if not gradient:
            return None
        for level in range(len(self.pyramid), 0, -1):
            pulled, step = cotangents.pop(), self.pyramid[level - 1]
            if pulled is None:
                continue
            if level == 1 and self.narrow:
                cotangents[0] = step.along(pulled, step.rows(adjoint=True), -2)
            else:
                cotangents[level - 1] = step.adjoint(pulled, cotangents[level - 1])
            del pulled
        return cotangents[0]

    def _compare_extent(
        self, extent: _Extent, source: Tensor, costs: Tensor, chunk: _Chunk, total: Tensor | None, *, gradient: bool
    ) -> Tensor | None:
        """Write the sums of costs of one extent; return the cotangent of `source`, added to `total`."""
        blur, power = extent.blur, 1.0 / self.scales.p
        weight = chunk.level_weight / (extent.height * extent.width)
        settings = (chunk.tie, weight, power)
        flags = {"PLAIN": self.scales.p == 1.0, "GRADIENT": gradient}
        if extent.windows is not None:
            stack = blur.along(source, blur.columns(adjoint=False), -1)
            cells, planes = stack.shape[-2], chunk.levels * chunk.planes
            # A window reads cells that another one writes.
            pulled = stack if extent.windows.count == 1 or not gradient else self.run.empty(*stack.shape)
            count, rows, window_cells = extent.windows.matrices.shape
            self.run.launch(
                kernels.compare_rows,
                (planes, count, -(-extent.width // COLUMNS)),
                stack,
                pulled,
                costs,
                extent.windows.windows,
                extent.windows.matrices,
                rows,
                extent.width,
                cells,
                *settings,
                CELLS=window_cells,
                ROWS=WINDOW_ROWS,
                COLUMNS=COLUMNS,
                operations=(4.0 if gradient else 2.0) * planes * count * rows * extent.width * window_cells,
                **flags,
            )
            del stack
            return blur.along(pulled, blur.columns(adjoint=True), -1, total) if gradient else None
        stack = source if blur.plan.is_identity else blur.apply(source)
        size = stack.numel()
        grid = (-(-size // (ELEMENTS * STEPS)),)
        self.run.launch(
            kernels.compare_stack, grid, stack, costs, size, *settings, BLOCK=ELEMENTS, STEPS=STEPS, **flags
        )
        if not gradient:
            return None
        if not blur.plan.is_identity:
            return blur.adjoint(stack, total)
        if total is None:
            return stack
        self.run.count("add", total, stack)
        return total.add_(stack)

    def _compare_near(
        self, extent: _Extent, chunk: _Chunk, cotangent: Tensor | None, costs: Tensor, *, add: bool
    ) -> None:
        """Write the sums of costs of an extent with tiles, and write or add to the cotangent of the image."""
        count, height, width = chunk.image.shape
        rows, columns = _tiles(extent)
        products = 4.0 if cotangent is not None else 2.0
        self.run.launch(
            kernels.compare_near,
            (count, rows.count, columns.count),
            chunk.image,
            chunk.reference,
            chunk.image if chunk.weights is None else chunk.weights,
            chunk.image if cotangent is None else cotangent,
            costs,
            rows.matrices,
            columns.matrices,
            height,
            width,
            rows.radius,
            columns.radius,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            chunk.slope_scale,
            chunk.tie,
            chunk.level_weight / (height * width),
            1.0 / self.scales.p,
            TILE=TILE,
            WEIGHTED=chunk.weights is not None,
            PLAIN=self.scales.p == 1.0,
            GRADIENT=cotangent is not None,
            ADD=add,
            warps=16,  # fewer would spill
            operations=products * 2.0 * TILE**3 * count * rows.count * columns.count * chunk.levels,
        )

    def _differences(self, chunk: _Chunk) -> Tensor:
        """Return the weighted differences of CDFs, shape (L, N, H, W)."""
        count, height, width = chunk.image.shape
        stack = self.run.empty(chunk.levels, count, height, width)
        weights = None if self.scales.centred else chunk.weights
        self.run.launch(
            kernels.difference_stack,
            (count, -(-height * width // ELEMENTS)),
            chunk.image,
            chunk.reference,
            chunk.image if weights is None else weights,
            stack,
            height * width,
            count,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            BLOCK=ELEMENTS,
            WEIGHTED=weights is not None,
        )
        if self.scales.centred:
            self._centre(stack, chunk.weights)
            if chunk.weights is not None:
                self.run.count("multiply", stack, chunk.weights)
                stack.mul_(chunk.weights)
        return stack

    def _narrow_differences(self, chunk: _Chunk) -> Tensor:
        """Return the weighted differences of CDFs, blurred along columns, shape (L, N, H, w)."""
        count, height, width = chunk.image.shape
        matrix = self.pyramid[0].columns(adjoint=False)
        stack = self.run.empty(chunk.levels, count, height, matrix.cells)
        levels = power_of_two(chunk.levels, 1)
        rows = LEVEL_ROWS // levels
        self.run.launch(
            kernels.difference_columns,
            (count, -(-height // rows), matrix.blocks),
            chunk.image,
            chunk.reference,
            chunk.image if chunk.weights is None else chunk.weights,
            stack,
            matrix.starts,
            matrix.table,
            height,
            width,
            matrix.cells,
            matrix.depth,
            count,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            LEVELS=levels,
            ROWS=rows,
            BLOCK=matrix.block,
            DEPTH=DEPTH,
            WEIGHTED=chunk.weights is not None,
            warps=matrix.warps,
            operations=2.0 * count * height * levels * matrix.blocks * matrix.block * matrix.depth,
        )
        return stack

    def _pull(self, stack: Tensor, chunk: _Chunk, cotangent: Tensor, *, add: bool) -> None:
        """Write or add to the cotangent of the image, from cotangents of (narrow or whole) differences of CDFs."""
        count, height, width = chunk.image.shape
        weights = chunk.image if chunk.weights is None else chunk.weights
        flags = {"WEIGHTED": chunk.weights is not None, "ADD": add}
        if not self.narrow:
            if self.scales.centred:
                self._centre(stack, chunk.weights)
            self.run.launch(
                kernels.pull_stack,
                (count, -(-height * width // ELEMENTS)),
                stack,
                chunk.image,
                weights,
                cotangent,
                height * width,
                count,
                chunk.first_level,
                chunk.last_level,
                *chunk.tonal,
                chunk.slope_scale,
                BLOCK=ELEMENTS,
                **flags,
            )
            return
        matrix = self.pyramid[0].columns(adjoint=True)
        self.run.launch(
            kernels.pull_columns,
            (count, -(-height // PULLED_ROWS), matrix.blocks),
            stack,
            chunk.image,
            weights,
            cotangent,
            matrix.starts,
            matrix.table,
            height,
            width,
            matrix.size,
            matrix.depth,
            count,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            chunk.slope_scale,
            ROWS=PULLED_ROWS,
            BLOCK=matrix.block,
            DEPTH=DEPTH,
            warps=matrix.warps,
            operations=2.0 * chunk.levels * count * height * matrix.blocks * matrix.block * matrix.depth,
            **flags,
        )

    def _centre(self, stack: Tensor, weights: Tensor | None) -> None:
        """Subtract the (weighted) means over pixels from planes, shape (L, N, h, w)."""
        if weights is None:
            means = stack.mean((-2, -1), keepdim=True)
        else:
            # One level at a time: the product with the weights is a plane, not a stack.
            sums = torch.stack([(level * weights).sum((-2, -1), keepdim=True) for level in stack])
            total = weights.sum((-2, -1), keepdim=True)
            means = sums / torch.where(total > 0.0, total, torch.ones_like(total))
        for _ in range(1 if weights is None else 2 * stack.shape[0]):
            self.run.count("mean", stack)
        self.run.count("subtract", stack)
        stack.sub_(means)


def _intensity(scales: ScaleSpace, plan: InnerPlan, run: Launcher, planes: Tensor) -> Tensor:
    """Return blurred planes, less the padding."""
    planes = planes.contiguous()
    blur = _Blur(plan.blur, run)
    if not blur.plan.is_identity:
        return blur.apply(planes, offset=scales.padding)
    if scales.padding == 0.0:
        return planes
    run.count("subtract", planes)
    return torch.sub(planes, scales.padding, out=run.empty(*planes.shape))


def _tiles(extent: _Extent) -> tuple[Tiles, Tiles]:
    assert extent.tiles is not None  # noqa: S101  # only extents with tiles are compared by them
    return extent.tiles


def _present(tensor: Tensor | None) -> Tensor:
    assert tensor is not None  # noqa: S101  # an invariant of the order in which stacks are made
    return tensor


@dataclass(frozen=True)
class TritonComparison:
    """Comparison by kernels, for float32 tensors: a :class:`loi_core.method.comparison.Comparison`.

    Every plan is exact: the sampling errors of a looser one would have to be read from the GPU.
    """

    inner: tuple[_Inner, ...]

    @classmethod
    def of(
        cls,
        scales: ScaleSpace,
        plan: Plan,
        reference: Tensor,
        weights: Tensor | None = None,
        run: Launcher | None = None,
    ) -> TritonComparison:
        """Prepare a comparison with a reference: planes within the bounds, and weights, shape (N, H, W)."""
        if plan.is_sampled or plan.tolerance > 0.0:
            plan = make_plan(scales, plan.height, plan.width, tolerance=0.0, eps=plan.eps, weighted=weights is not None)
        run = run or Launcher(reference.device)
        weights = None if weights is None else weights.contiguous()
        keep = len(plan.inner) == 1
        return cls(
            tuple(
                _Inner.of(scales, inner_plan, plan.tonal, run, reference, weights, keep_intensity=keep)
                for inner_plan in plan.inner
            )
        )

    def with_weights(self, weights: Tensor) -> TritonComparison:
        """See :class:`loi_core.method.comparison.Comparison`."""
        weights = weights.contiguous()
        return TritonComparison(tuple(replace(inner, weights=weights) for inner in self.inner))

    def compare(self, compressed: Any, *, gradient: bool) -> ComparisonResult:
        """See :class:`loi_core.method.comparison.Comparison`."""
        terms: Terms = {}
        total: Tensor | None = None
        for inner in self.inner:
            some, total = inner.compare(compressed, total, gradient=gradient)
            terms |= some
        return ComparisonResult(terms, total)

"""The comparison in Triton: few launches, and no CDF at the resolution of the images.

Extents are compared in chains. One chain holds all extents that start from a pyramid; each of the others is a chain of
its own. The differences of CDFs are made in registers, and one kernel blurs them along columns, down to the rows of
the first pyramid level. Blurred along rows as well, and back up, they are reduced to signs in registers, which are
written in 2 bits each; and the adjoint of the first kernel ends in the gradient of the image. Only `centred` scales,
which need means over the image, write the differences. A chain handles some planes and levels at a time, which bounds
the memory.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import torch
from torch import Tensor

from loi_core.method.comparison import ComparisonResult, Terms
from loi_core.method.distance import tie_threshold
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.planner import make_plan
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import ROOT_TWO
from loi_torch.triton_backend import kernels
from loi_torch.triton_backend.launching import EXPONENTIAL, Launcher
from loi_torch.triton_backend.stack_blurs import StackBlur
from loi_torch.triton_backend.tables import DEPTH, aligned_band, power_of_two, tile_band

__all__ = ["TritonComparison"]

MEMORY_PLANES: Final = 15
"""Memory for the planes that are handled at once and their stacks of levels, in planes of the images' size."""

MIN_MEMORY: Final = 2**26
"""Bytes that they may take in any case."""

MAX_LEVELS: Final = 64  # that are handled at once: `difference_wide_columns` holds them all in registers
ELEMENTS: Final = 1024  # of a block of an elementwise kernel
COLUMNS: Final = 64  # of a tile of `compare_rows` and `pull_signs`
TILE: Final = 2048  # rows times columns of a tile of `difference_columns`
PULLED_ROWS: Final = 16
LEVEL_ROWS: Final = 128  # levels times rows of a tile of `difference_wide_columns`


@dataclass(frozen=True)
class _Extent:
    """An extent with the index of its terms, from a pyramid level, or from the images."""

    index: int
    alpha: float
    start: int
    blur: StackBlur
    plain: bool  # whether the slopes of costs are signs

    @property
    def height(self) -> int:
        return self.blur.plan.rows.target.cells

    @property
    def width(self) -> int:
        return self.blur.plan.columns.target.cells

    @property
    def narrow(self) -> int:
        """Elements of a plane that is blurred along columns only."""
        return self.blur.plan.rows.source.cells * self.width

    @property
    def slopes(self) -> tuple[int, int]:
        """The shape of a plane of slopes, or of words of 16 signs."""
        return (-(-self.height // 16) if self.plain else self.height), self.width


@dataclass(frozen=True)
class _Chain:
    """Extents with a common input: an extent that starts from the images, or all extents that start from a pyramid."""

    pyramid: tuple[StackBlur, ...]
    extents: tuple[_Extent, ...]
    centred: bool

    @property
    def first(self) -> StackBlur:
        """The blur along whose columns differences are blurred as they are made."""
        return self.pyramid[0] if self.pyramid else self.extents[0].blur

    @functools.cached_property
    def elements(self) -> int:
        """About the most elements that a plane of a level takes at once."""
        cells = [0, *(step.plan.target.cells for step in self.pyramid)]
        starts = [extent.start for extent in self.extents]
        shared = sum(cells[start] for start in set(starts) if starts.count(start) > 1)  # beside its cotangent
        # The stack is freed before the slopes are written, unless another extent needs it.
        compared = max(
            extent.narrow + max(0, math.prod(extent.slopes) - cells[extent.start]) for extent in self.extents
        )
        plan = self.first.plan
        narrow = plan.rows.source.cells * plan.columns.target.cells
        differences = plan.source.cells if self.centred else 0
        return sum(cells) + shared + max(compared, narrow + differences)


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
    costs: Tensor  # shape (extents, programs)
    before: int  # planes of levels in the chunks before

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
    chains: tuple[_Chain, ...]

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
        extents = [
            _Extent(index, extent.alpha, extent.start, StackBlur(extent.blur, run), scales.p == 1.0)
            for index, extent in enumerate(plan.extents)
        ]
        chains = [_Chain((), (extent,), scales.centred) for extent in extents if extent.start == 0]
        coarse = tuple(sorted((extent for extent in extents if extent.start > 0), key=lambda extent: extent.start))
        if coarse:
            pyramid = tuple(StackBlur(step, run) for step in plan.pyramid)
            chains.append(_Chain(pyramid, coarse, scales.centred))
        return cls(scales, plan, tonal, run, reference, intensity, weights, tuple(chains))

    def compare(self, compressed: Tensor, total: Tensor | None, *, gradient: bool) -> tuple[Terms, Tensor | None]:
        """Return the terms, and the gradient added to `total`, which is overwritten."""
        count = compressed.shape[0]
        extents = [extent for chain in self.chains for extent in chain.extents]
        programs = max(
            count * (tonal.last - tonal.first) * self._programs(extent) for extent in extents for tonal in self.tonal
        )
        costs = self.run.empty(len(self.tonal), len(extents), programs).zero_()
        self.run.count("zero", costs)
        size = self._planes_at_once(count)
        gradients = total
        for start in range(0, count, size):
            planes = slice(start, min(start + size, count))
            cotangent = None
            for chain, chunk in self._chunks(compressed, planes, costs):
                pulled = self._compare(chain, chunk, gradient=gradient)
                if pulled is None:
                    continue
                # Only now, when most of the stacks are gone.
                gradients = self.run.empty(*compressed.shape) if gradients is None else gradients
                add = cotangent is not None
                if cotangent is None:
                    in_place = total is None and chunk.image.shape[1:] == compressed.shape[1:]
                    cotangent = gradients[planes] if in_place else self.run.empty(*chunk.image.shape)
                self._pull(chain, pulled, chunk, cotangent, add=add)
                del pulled
            del chunk
            if cotangent is not None and gradients is not None:
                self._pull_intensity(cotangent, gradients[planes], add=total is not None)
        sums = costs.sum(-1)
        self.run.count("sum", costs)
        terms = {
            (extent.alpha, tonal.beta, self.plan.sigma): sums[beta, extent.index]
            for beta, tonal in enumerate(self.tonal)
            for extent in extents
        }
        return terms, gradients

    def _pull_intensity(self, cotangent: Tensor, gradient: Tensor, *, add: bool) -> None:
        """Write or add the gradient of the image, from cotangents of its intensities, which may be the same memory."""
        blur = StackBlur(self.plan.blur, self.run)
        if not blur.plan.is_identity:
            blur.adjoint(cotangent, gradient if add else None, gradient)
        elif add:
            self.run.count("add", gradient, cotangent)
            gradient.add_(cotangent)

    def _planes_at_once(self, count: int) -> int:
        """Return the number of planes per chunk with the fewest launches."""

        def chunks(planes: int) -> int:
            levels = [self._levels(chain, tonal, planes) for chain in self.chains for tonal in self.tonal]
            return -(-count // planes) * (1 + sum(map(len, levels)))

        sizes = {-(-count // groups) for groups in range(1, count + 1)}
        fitting = [size for size in sizes if all(self._levels_at_once(chain, size) > 0 for chain in self.chains)]
        return min(fitting or [1], key=chunks)

    def _levels_at_once(self, chain: _Chain, planes: int) -> int:
        """Return how many levels of some planes fit in the memory beside two intensities and a cotangent."""
        cells = self.plan.grid.cells
        memory = max(MIN_MEMORY // 4, MEMORY_PLANES * cells) - 3 * planes * cells
        return min(memory // (planes * chain.elements), MAX_LEVELS)

    def _levels(self, chain: _Chain, tonal: TonalPlan, planes: int) -> list[tuple[int, int]]:
        """Return the first and last of the levels that are handled at once."""
        count = tonal.last - tonal.first
        groups = -(-count // max(1, self._levels_at_once(chain, planes)))
        edges = [tonal.first + count * group // groups for group in range(groups + 1)]
        return list(itertools.pairwise(edges))

    def _chunks(self, compressed: Tensor, planes: slice, costs: Tensor) -> Iterator[tuple[_Chain, _Chunk]]:
        """Yield the chunks of some planes, with the chains that compare them."""
        scales = self.scales
        intensity = _intensity(scales, self.plan, self.run, compressed[planes])
        reference = self.reference_intensity
        if reference is None:
            reference = _intensity(scales, self.plan, self.run, self.reference[planes])
        else:
            reference = reference[planes]
        weights = None if self.weights is None else self.weights[planes]
        for chain, (index, tonal) in itertools.product(self.chains, enumerate(self.tonal)):
            beta = tonal.beta
            spacing = scales.spacing(beta)
            width, mass = beta / spacing, scales.mass(beta) / spacing
            for first, last in self._levels(chain, tonal, intensity.shape[0]):
                yield (
                    chain,
                    _Chunk(
                        first,
                        last,
                        intensity,
                        reference,
                        weights,
                        (
                            float(scales.levels(beta)[0]) - scales.padding,
                            1.0 / spacing,
                            float(scales.level_count(beta)),
                            1.0 / (ROOT_TWO * width),
                            math.log(mass / (math.sqrt(2.0 * math.pi) * width)),
                        ),
                        ROOT_TWO / width / spacing,
                        tie_threshold(self.reference, mass),
                        scales.scale_weight * scales.level_weight(beta) / compressed.shape[0],
                        costs[index],
                        planes.start * (tonal.last - tonal.first) + intensity.shape[0] * (first - tonal.first),
                    ),
                )

    def _programs(self, extent: _Extent) -> int:
        """Return the number of partial sums of costs of a plane of a level."""
        return extent.blur.rows(adjoint=False).blocks * -(-extent.width // COLUMNS)

    def _compare(self, chain: _Chain, chunk: _Chunk, *, gradient: bool) -> Tensor | None:
        """Write sums of costs of extents; return cotangents of the differences that are blurred along columns."""
        narrow = self._narrow_differences(chain, chunk)
        if not chain.pyramid:
            (extent,) = chain.extents
            slopes = self._compare_rows(extent, narrow, chunk, gradient=gradient)
            del narrow
            return None if slopes is None else self._pull_rows(extent, slopes, chunk)
        first = chain.first
        stacks: list[Tensor | None] = [None, first.along(narrow, first.rows(adjoint=False), -2)]
        del narrow
        for step in chain.pyramid[1:]:
            stacks.append(step.apply(_present(stacks[-1])))
        cotangents: list[Tensor | None] = [None] * len(stacks)
        for extent, following in itertools.zip_longest(chain.extents, chain.extents[1:]):
            level, blur = extent.start, extent.blur
            narrow = blur.along(_present(stacks[level]), blur.columns(adjoint=False), -1)
            if following is None or following.start != level:
                stacks[level] = None
            slopes = self._compare_rows(extent, narrow, chunk, gradient=gradient)
            del narrow
            if slopes is None:
                continue
            narrow = self._pull_rows(extent, slopes, chunk)
            del slopes
            cotangents[level] = blur.along(narrow, blur.columns(adjoint=True), -1, cotangents[level])
            del narrow
        if not gradient:
            return None
        for level in range(len(chain.pyramid), 1, -1):
            pulled = cotangents.pop()
            if pulled is not None:
                cotangents[level - 1] = chain.pyramid[level - 1].adjoint(pulled, cotangents[level - 1])
            del pulled
        return first.along(_present(cotangents.pop()), first.rows(adjoint=True), -2)

    def _compare_rows(self, extent: _Extent, narrow: Tensor, chunk: _Chunk, *, gradient: bool) -> Tensor | None:
        """Write the sums of costs of an extent; return the slopes of costs, or words of signs."""
        matrix = extent.blur.rows(adjoint=False)
        slopes = None
        if gradient:
            dtype = torch.int32 if extent.plain else torch.float32
            slopes = self.run.empty(chunk.levels, chunk.planes, *extent.slopes, dtype=dtype)
        planes = chunk.levels * chunk.planes
        rows = matrix.blocks * matrix.block
        self.run.launch(
            kernels.compare_rows,
            (planes, matrix.blocks, -(-extent.width // COLUMNS)),
            narrow,
            narrow if slopes is None else slopes,
            chunk.costs[extent.index, chunk.before * self._programs(extent) :],
            matrix.starts,
            matrix.table,
            matrix.size,
            matrix.cells,
            extent.width,
            matrix.depth,
            chunk.tie,
            chunk.level_weight / (extent.height * extent.width),
            1.0 / self.scales.p,
            BLOCK=matrix.block,
            COLUMNS=COLUMNS,
            DEPTH=DEPTH,
            PLAIN=extent.plain,
            GRADIENT=gradient,
            warps=matrix.warps,
            operations=planes * rows * extent.width * (2.0 * matrix.depth + (0.0 if extent.plain else 2 * EXPONENTIAL)),
        )
        return slopes

    def _pull_rows(self, extent: _Extent, slopes: Tensor, chunk: _Chunk) -> Tensor:
        """Return the adjoint of the blur along rows of slopes of costs."""
        if not extent.plain:
            return extent.blur.along(slopes, extent.blur.rows(adjoint=True), -2)
        matrix = aligned_band(extent.blur.plan.rows, self.run.device)
        *outer, words, width = slopes.shape
        target = self.run.empty(*outer, matrix.cells, width)
        planes = math.prod(outer)
        self.run.launch(
            kernels.pull_signs,
            (planes, matrix.blocks, -(-width // COLUMNS)),
            slopes,
            target,
            matrix.starts,
            matrix.table,
            words,
            matrix.cells,
            width,
            matrix.depth,
            chunk.level_weight / (extent.height * extent.width),
            BLOCK=matrix.block,
            COLUMNS=COLUMNS,
            warps=matrix.warps,
            operations=2.0 * planes * width * matrix.blocks * matrix.block * matrix.depth,
        )
        return target

    def _narrow_differences(self, chain: _Chain, chunk: _Chunk) -> Tensor:
        """Return the weighted differences of CDFs, blurred along columns, shape (L, N, H, w)."""
        if self.scales.centred:
            return chain.first.along(self._differences(chunk), chain.first.columns(adjoint=False), -1)
        count, height, width = chunk.image.shape
        tile = tile_band(chain.first.plan.columns, self.run.device)
        matrix = chain.first.columns(adjoint=False) if tile is None else tile
        stack = self.run.empty(chunk.levels, count, height, matrix.cells)
        levels = power_of_two(chunk.levels, 1)
        rows = LEVEL_ROWS // levels if tile is None else TILE // matrix.depth
        columns = matrix.blocks * matrix.depth
        made = levels + chunk.first_level if tile is None else chunk.last_level
        products = levels if tile is None else chunk.levels
        constants = {"LEVELS": levels, "DEPTH": DEPTH} if tile is None else {"DEPTH": matrix.depth}
        self.run.launch(
            kernels.difference_wide_columns if tile is None else kernels.difference_columns,
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
            matrix.depth if tile is None else matrix.own,
            count,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            ROWS=rows,
            BLOCK=matrix.block,
            WEIGHTED=chunk.weights is not None,
            warps=matrix.warps,
            operations=count * height * columns * (2.0 * products * matrix.block + 2 * EXPONENTIAL * made),
            **constants,
        )
        return stack

    def _differences(self, chunk: _Chunk) -> Tensor:
        """Return the centred and weighted differences of CDFs, shape (L, N, H, W)."""
        count, height, width = chunk.image.shape
        stack = self.run.empty(chunk.levels, count, height, width)
        self.run.launch(
            kernels.difference_stack,
            (count, -(-height * width // ELEMENTS)),
            chunk.image,
            chunk.reference,
            stack,
            height * width,
            count,
            chunk.first_level,
            chunk.last_level,
            *chunk.tonal,
            BLOCK=ELEMENTS,
            operations=count * height * width * chunk.last_level * 2 * EXPONENTIAL,
        )
        self._centre(stack, chunk.weights)
        if chunk.weights is not None:
            self.run.count("multiply", stack, chunk.weights)
            stack.mul_(chunk.weights)
        return stack

    def _pull(self, chain: _Chain, narrow: Tensor, chunk: _Chunk, cotangent: Tensor, *, add: bool) -> None:
        """Write or add to the cotangent of the image, from cotangents of differences blurred along columns."""
        count, height, width = chunk.image.shape
        weights = chunk.image if chunk.weights is None else chunk.weights
        matrix = chain.first.columns(adjoint=True)
        arguments = (chunk.first_level, chunk.last_level, *chunk.tonal, chunk.slope_scale)
        flags = {"WEIGHTED": chunk.weights is not None, "ADD": add}
        if self.scales.centred:
            stack = chain.first.along(narrow, matrix, -1)
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
                *arguments,
                BLOCK=ELEMENTS,
                operations=count * height * width * chunk.last_level * EXPONENTIAL,
                **flags,
            )
            return
        columns = matrix.blocks * matrix.block
        products = 2.0 * chunk.levels * matrix.depth + chunk.last_level * EXPONENTIAL
        self.run.launch(
            kernels.pull_columns,
            (count, -(-height // PULLED_ROWS), matrix.blocks),
            narrow,
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
            *arguments,
            ROWS=PULLED_ROWS,
            BLOCK=matrix.block,
            DEPTH=DEPTH,
            warps=matrix.warps,
            operations=count * height * columns * products,
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
    blur = StackBlur(plan.blur, run)
    if not blur.plan.is_identity:
        return blur.apply(planes, offset=scales.padding)
    if scales.padding == 0.0:
        return planes
    run.count("subtract", planes)
    return torch.sub(planes, scales.padding, out=run.empty(*planes.shape))


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

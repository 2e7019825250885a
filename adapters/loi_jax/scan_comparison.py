"""Comparison of planes by loops that XLA keeps as loops, so that programs compile in seconds for images of any size.

The loops over planes and levels of :mod:`loi_core.method.array_comparison` are Python's: traced, they would grow with
the image into tens of thousands of operations. Here groups of equally many levels are scanned, and groups of planes
are mapped. Levels and planes that complete the last group add nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from loi_core.method.comparison import ComparisonResult, Terms
from loi_core.method.dispatch import Backend, OwnLibrary
from loi_core.method.distance import cost_slope, sum_of_costs, tie_threshold
from loi_core.method.gaussian import AxisBlur, Matrix
from loi_core.method.plan import InnerPlan, Plan, TonalPlan
from loi_core.method.plane_blurs import PlaneBlur
from loi_core.method.scales import ScaleSpace
from loi_core.method.tonal import accumulate, level_weights, to_level_units, weights_and_slopes
from loi_core.pixels.bounds import above_padding

__all__ = ["SCAN", "ScanComparison"]

MAX_ELEMENTS: Final = 2**22  # of a stack of levels: 16 MiB in float32
MAX_DENSE_CELLS: Final = 256  # an axis of so few cells is multiplied by one dense matrix
BLOCK_CELLS: Final = 128  # of a longer axis that are multiplied by one block of a band matrix


class _Sums(NamedTuple):
    """Sums over the levels below a group: the CDFs of image and reference, and the slope of the image's."""

    image: jax.Array
    reference: jax.Array
    slope: jax.Array


class _Scan(OwnLibrary):
    """The :class:`loi_core.method.dispatch.Backend` of programs without values to read."""

    def comparison(
        self, scales: ScaleSpace, plan: Plan, reference: jax.Array, weights: jax.Array | None = None
    ) -> ScanComparison:
        return ScanComparison(scales, plan, reference, weights)


@dataclass(frozen=True)
class ScanComparison:
    """A :class:`loi_core.method.comparison.Comparison` for JAX arrays, traced or not; it samples no extent.

    Attributes
    ----------
    scales : ScaleSpace
    plan : Plan
        An exact plan.
    reference : array, shape (N, H, W)
        Planes within the bounds.
    weights : array, shape (N, H, W), optional
    """

    scales: ScaleSpace
    plan: Plan
    reference: jax.Array
    weights: jax.Array | None = None

    def with_weights(self, weights: jax.Array) -> ScanComparison:
        """See :class:`loi_core.method.comparison.Comparison`."""
        return ScanComparison(self.scales, self.plan, self.reference, weights)

    def compare(self, compressed: jax.Array, *, gradient: bool) -> ComparisonResult:
        """See :class:`loi_core.method.comparison.Comparison`."""
        terms: Terms = {}
        total = jnp.zeros_like(compressed) if gradient else None
        for inner in self.plan.inner:
            comparison = _InnerComparison(self.scales, inner, compressed.shape[0], gradient)
            costs, cotangent = comparison.compare(self.plan.tonal, compressed, self.reference, self.weights)
            for tonal, extents in zip(self.plan.tonal, costs, strict=True):
                terms |= {
                    (extent.alpha, tonal.beta, inner.sigma): extents[index]
                    for index, extent in enumerate(inner.extents)
                }
            if total is not None:
                total = total + cotangent
        return ComparisonResult(terms, total)


@dataclass(frozen=True)
class _InnerComparison:
    """The comparison at one inner scale, of images with `count` planes."""

    scales: ScaleSpace
    plan: InnerPlan
    count: int
    gradient: bool

    def compare(
        self, tonal: tuple[TonalPlan, ...], image: jax.Array, reference: jax.Array, weights: jax.Array | None
    ) -> tuple[list[jax.Array], jax.Array]:
        """Return the costs by tonal scale, each of shape (extents,), and the cotangent of the image, (N, H, W)."""
        both = above_padding(jnp.concatenate([image, reference]), self.scales.padding)
        intensities = _blur(self.plan.blur, both)
        planes_at_once = max(1, min(self.count, MAX_ELEMENTS // self.plan.finest))
        groups = -(-self.count // planes_at_once)
        stacks = [intensities[: self.count], intensities[self.count :], *([] if weights is None else [weights])]
        grouped = [_grouped(stack, groups, planes_at_once) for stack in stacks]
        compare = partial(self._compare_planes, tonal)
        if groups == 1:
            costs, cotangent = compare([stack[0] for stack in grouped])
        else:
            mapped_costs, mapped_cotangent = lax.map(compare, grouped)
            costs = [jnp.sum(cost, axis=0) for cost in mapped_costs]
            cotangent = mapped_cotangent.reshape(-1, *mapped_cotangent.shape[2:])
        return costs, _adjoint(self.plan.blur, cotangent[: self.count])

    def _compare_planes(self, tonal: tuple[TonalPlan, ...], stacks: list[jax.Array]) -> tuple[list[jax.Array], Any]:
        """Compare some planes at all tonal scales: intensities of image and reference, and weights if there are any."""
        image, reference, *weights = stacks
        costs = []
        total = jnp.zeros_like(image)
        for plan in tonal:
            cost, cotangent = self._compare_levels(plan, image, reference, weights[0] if weights else None)
            costs.append(cost)
            total = total + cotangent / self.scales.spacing(plan.beta)
        return costs, total

    def _compare_levels(
        self, plan: TonalPlan, image: jax.Array, reference: jax.Array, weights: jax.Array | None
    ) -> tuple[jax.Array, jax.Array]:
        """Compare planes, shape (P, h, w), at one tonal scale; the cotangent is in units of the spacing of levels."""
        positions, width, mass = to_level_units(image, self.scales, plan.beta)
        expected, *_ = to_level_units(reference, self.scales, plan.beta)
        levels_at_once = max(1, min(plan.last, MAX_ELEMENTS // (image.shape[0] * self.plan.finest)))
        groups = -(-plan.last // levels_at_once)
        numbers = np.arange(groups * levels_at_once).reshape(groups, levels_at_once)
        compared = (plan.first <= numbers) & (numbers < plan.last)
        tie = tie_threshold(image, mass)

        def step(
            carry: tuple[_Sums, jax.Array, jax.Array], group: tuple[jax.Array, jax.Array]
        ) -> tuple[tuple[_Sums, jax.Array, jax.Array], None]:
            sums, costs, cotangent = carry
            levels, counts = group
            densities, slopes = weights_and_slopes(positions, levels, width, mass)
            cdf, image_sum = accumulate(densities, sums.image)
            cdf_reference, reference_sum = accumulate(level_weights(expected, levels, width, mass), sums.reference)
            difference = _centred(cdf - cdf_reference, weights, centred=self.scales.centred)
            difference = difference * counts[:, None, None, None] * (1.0 if weights is None else weights)
            group_costs, pulled = self._pull_back(difference, plan.beta, tie)
            costs = costs + group_costs
            slope_sum = sums.slope
            if self.gradient:
                slope, slope_sum = accumulate(slopes, slope_sum)
                pulled = _centred(pulled, weights, centred=self.scales.centred) * slope
                pulled = pulled * counts[:, None, None, None] * (1.0 if weights is None else weights)
                cotangent = cotangent + jnp.sum(pulled, axis=0)
            return (_Sums(image_sum, reference_sum, slope_sum), costs, cotangent), None

        zero = jnp.zeros_like(image)
        start = _Sums(zero, zero, zero), jnp.zeros(len(self.plan.extents), image.dtype), zero
        inputs = jnp.asarray(numbers, image.dtype), jnp.asarray(compared, image.dtype)
        if groups == 1:
            (_, costs, cotangent), _ = step(start, (inputs[0][0], inputs[1][0]))
        else:
            (_, costs, cotangent), _ = lax.scan(step, start, inputs)
        return costs, cotangent

    def _pull_back(self, difference: jax.Array, beta: float, tie: float) -> tuple[jax.Array, jax.Array]:
        """Return the cost of each extent, shape (extents,), of a difference of CDFs, and their cotangent."""
        differences = [difference]
        for blur in self.plan.pyramid:
            differences.append(_blur(blur, differences[-1]))
        cotangents: list[jax.Array | None] = [None] * len(differences)
        costs = []
        for extent in self.plan.extents:
            blurred = _blur(extent.blur, differences[extent.start])
            cells = extent.blur.target.cells
            weight = self.scales.scale_weight * self.scales.level_weight(beta) / (self.count * cells)
            slope = cost_slope(blurred, self.scales.p, tie, weight)
            costs.append(sum_of_costs(blurred, slope, self.scales.p))
            if self.gradient:
                pulled = _adjoint(extent.blur, slope)
                previous = cotangents[extent.start]
                cotangents[extent.start] = pulled if previous is None else previous + pulled
        for level in range(len(self.plan.pyramid), 0, -1):
            cotangent, previous = cotangents[level], cotangents[level - 1]
            if cotangent is not None:
                pulled = _adjoint(self.plan.pyramid[level - 1], cotangent)
                cotangents[level - 1] = pulled if previous is None else previous + pulled
        return jnp.stack(costs), difference if cotangents[0] is None else cotangents[0]


def _grouped(stack: jax.Array, groups: int, size: int) -> jax.Array:
    """Return planes in groups, shape (groups, size, H, W), completed by zeros."""
    missing = groups * size - stack.shape[0]
    padded = jnp.concatenate([stack, jnp.zeros((missing, *stack.shape[1:]), stack.dtype)]) if missing else stack
    return padded.reshape(groups, size, *stack.shape[1:])


def _centred(stack: jax.Array, weights: jax.Array | None, *, centred: bool) -> jax.Array:
    """Return a stack, shape (L, P, h, w), less its mean over pixels if `centred`."""
    if not centred:
        return stack
    if weights is None:
        return stack - jnp.mean(stack, axis=(-2, -1), keepdims=True)
    total = jnp.sum(weights, axis=(-2, -1), keepdims=True)
    mean = jnp.sum(stack * weights, axis=(-2, -1), keepdims=True) / jnp.where(total > 0.0, total, 1.0)
    return stack - mean


def _blur(blur: PlaneBlur, planes: jax.Array) -> jax.Array:
    """Return blurred planes, shape (..., h, w)."""
    if blur.is_identity:
        return planes
    steps = [(blur.columns, False), (blur.rows, True)]
    return _multiplied(steps if blur.columns_first else steps[::-1], planes, adjoint=False)


def _adjoint(blur: PlaneBlur, planes: jax.Array) -> jax.Array:
    """Apply the transpose of :func:`_blur`."""
    if blur.is_identity:
        return planes
    steps = [(blur.rows, True), (blur.columns, False)]
    return _multiplied(steps if blur.columns_first else steps[::-1], planes, adjoint=True)


def _multiplied(steps: list[tuple[AxisBlur, bool]], planes: jax.Array, *, adjoint: bool) -> jax.Array:
    for axis_blur, vertical in steps:
        moved = jnp.swapaxes(planes, -1, -2) if vertical else planes
        moved = _along_axis(axis_blur, moved, adjoint=adjoint)
        planes = jnp.swapaxes(moved, -1, -2) if vertical else moved
    return planes


def _along_axis(blur: AxisBlur, lines: jax.Array, *, adjoint: bool) -> jax.Array:
    """Multiply the last axis of `lines` by the matrix of a blur, or by its transpose.

    Blocks of equally many results are one batched product, each with the part of the axis that it depends on.
    """
    source, target = (blur.target, blur.source) if adjoint else (blur.source, blur.target)
    if max(source.cells, target.cells) <= MAX_DENSE_CELLS:
        matrix = blur.matrix() if adjoint else blur.matrix().T
        return _product(lines, jnp.asarray(matrix, lines.dtype))
    count = -(-target.cells // BLOCK_CELLS)
    blocks = [range(k * target.cells // count, (k + 1) * target.cells // count) for k in range(count)]
    supports = [blur.rows_of(block) if adjoint else blur.columns_of(block) for block in blocks]
    size, reach = max(map(len, blocks)), max(map(len, supports))
    if reach == source.cells:
        matrix = blur.matrix() if adjoint else blur.matrix().T
        return _product(lines, jnp.asarray(matrix, lines.dtype))
    factors = np.zeros((count, reach, size))
    starts = np.zeros(count, dtype=np.int64)
    for k, (block, support) in enumerate(zip(blocks, supports, strict=True)):
        starts[k] = min(support.start, source.cells - reach)
        offset = support.start - starts[k]
        entries: Matrix = blur.entries(support, block) if adjoint else blur.entries(block, support).T
        factors[k, offset : offset + len(support), : len(block)] = entries
    windows = lines[..., starts[:, None] + np.arange(reach)]  # shape (..., count, reach)
    products = jnp.einsum(
        "...kr,krs->...ks", windows, jnp.asarray(factors, lines.dtype), precision=lax.Precision.HIGHEST
    )
    chosen = np.concatenate([k * size + np.arange(len(block)) for k, block in enumerate(blocks)])
    flat = products.reshape(*lines.shape[:-1], count * size)
    return flat if len(chosen) == count * size else flat[..., chosen]


def _product(lines: jax.Array, matrix: jax.Array) -> jax.Array:
    return jnp.matmul(lines, matrix, precision=lax.Precision.HIGHEST)


SCAN: Final[Backend] = _Scan()

"""Wide extents of one plane at one inner and one tonal scale: tiles that share coarse samplings of the plane."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loi_core.method.blurs import GaussianBlur, PlaneBlur, PlaneGrid
from loi_core.method.distance import cost_slope, sum_of_costs
from loi_core.method.gaussian import AxisBlur
from loi_core.method.sampling_error import Misplaced, Tally, misplaced
from loi_core.method.tiled.coarse import CoarseExtent, Link, Pyramid
from loi_core.method.tiled.tonal import TonalScale, kernels_for
from loi_core.method.tiled.turns import in_order
from loi_core.method.windows import Window
from loi_core.support.arrays import Host

__all__ = ["WideComparison"]


@dataclass
class WideComparison:
    """The differences of the CDFs of one plane on coarse samplings, and what is pulled back there.

    First every tile is put in (:meth:`gathered`, :meth:`add`), then all is compared (:meth:`compare`), and then every
    tile gets its cotangent (:meth:`pulled`).

    Attributes
    ----------
    tonal : TonalScale
    pyramid : Pyramid
        Of extents alone.
    tiles : sequence of Window
        Of the plane.
    planes : int
        How many planes the mean is over.
    samplings : dict of PlaneGrid
        By extent, where it is compared if not at every pixel.
    """

    tonal: TonalScale
    pyramid: Pyramid
    tiles: Sequence[Window]
    planes: int
    samplings: dict[float, PlaneGrid]
    dtype: np.dtype[Any]
    costs: dict[float, float] = field(init=False)
    misplaced: list[Misplaced] = field(init=False, default_factory=list)
    _differences: list[Host] = field(init=False)
    _pulled: list[Host] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        shape = len(self.tonal.levels), *self.pyramid.shape(1)
        self._differences = [np.zeros(shape, self.dtype)]
        self.costs = dict.fromkeys((extent.scale for extent in self.pyramid.extents), 0.0)

    def gathered(self, tile: Window, image: Host, reference: Host, shares: Host) -> tuple[Window, Host] | None:
        """What a tile of intensities above the padding, shape (h, w), gives to the samples in a window, if anything."""
        if np.array_equal(image, reference):
            return None
        tonal, kernels, link = self.tonal, kernels_for(self.dtype), self.pyramid.down(tile, self.dtype)
        ours, theirs = tonal.positions(image), tonal.positions(reference)
        gathered = np.zeros((len(tonal.levels), *link.window.shape), self.dtype)
        kernels.gather(ours, theirs, shares, tonal.levels, tonal.numbers, *link.operators, gathered)
        return link.window, gathered

    def add(self, gathered: tuple[Window, Host] | None) -> None:
        """Add what a tile has given."""
        if gathered is not None:
            window, part = gathered
            inside = window.crop(self._differences[0])
            inside += part

    def compare(self, *, gradient: bool) -> None:
        """Find what every extent costs, once all tiles are in."""
        like = self._differences[0]
        blurs = [GaussianBlur(step, like) for step in self.pyramid.steps[1:]]
        for blur in blurs:
            self._differences.append(blur.apply(self._differences[-1]))
        self._pulled = [np.zeros_like(each) for each in self._differences] if gradient else []
        exact = [extent for extent in self.pyramid.extents if extent.scale not in self.samplings]
        for extent in self.pyramid.extents:
            if extent.scale in self.samplings:
                self._compare_samples(extent, self.samplings[extent.scale])
        if exact:
            compare = functools.partial(self._compared, exact, gradient=gradient)
            for costs, parts in in_order(functools.partial(compare, tile) for tile in self.tiles):
                for extent, cost, part in zip(exact, costs, parts, strict=True):
                    self.costs[extent.scale] += cost
                    if part is not None:
                        inside = part[0].crop(self._pulled[extent.start - 1])
                        inside += part[1]
        if gradient:
            for index in range(len(blurs), 0, -1):
                self._pulled[index - 1] += blurs[index - 1].adjoint(self._pulled[index])

    def pulled(self, tile: Window, image: Host, shares: Host) -> Host:
        """The cotangent by the intensities of a tile, shape (h, w), once all is compared."""
        tonal, kernels, link = self.tonal, kernels_for(self.dtype), self.pyramid.down(tile, self.dtype)
        ours = tonal.positions(image)
        samples, cotangent = self._cropped(self._pulled[0], link), np.zeros(tile.shape, self.dtype)
        kernels.pull(ours, shares, tonal.levels, tonal.numbers, samples, *link.operators, cotangent)
        cotangent *= tonal.slope
        return cotangent

    @staticmethod
    def _cropped(samples: Host, link: Link) -> Host:
        return np.ascontiguousarray(link.window.crop(samples))

    def _compared(
        self, extents: Sequence[CoarseExtent], tile: Window, *, gradient: bool
    ) -> tuple[list[float], list[tuple[Window, Host] | None]]:
        """What extents cost at the pixels of a tile, and what is pulled back from there, by extent."""
        kernels, numbers = kernels_for(self.dtype), self.tonal.numbers
        weight = self.dtype.type(self.tonal.weight(self.planes, self._pixels))
        costs: list[float] = []
        parts: list[tuple[Window, Host] | None] = []
        for extent in extents:
            link = self.pyramid.up(extent, tile, self.dtype)
            samples = self._cropped(self._differences[extent.start - 1], link)
            part = np.zeros_like(samples) if gradient else np.zeros((0, 0, 0), self.dtype)
            costs.append(kernels.compare(samples, weight, numbers, *link.operators, part))
            parts.append((link.window, part) if gradient else None)
        return costs, parts

    def _compare_samples(self, extent: CoarseExtent, grid: PlaneGrid) -> None:
        """Compare an extent on a sampling of the whole plane, a level at a time, and estimate what that misplaces."""
        scales, differences = self.tonal.scales, self._differences[extent.start - 1]
        rows, columns = extent.blur.rows, extent.blur.columns
        blur = GaussianBlur(
            PlaneBlur(
                AxisBlur(rows.source, grid.rows, rows.scale, rows.boundary, None, rows.cut),
                AxisBlur(columns.source, grid.columns, columns.scale, columns.boundary, None, columns.cut),
            ),
            differences,
        )
        weight = self.tonal.weight(self.planes, grid.cells)
        tally = Tally(1, self._pixels, np.zeros((1, 2)), 1, len(differences))
        whole = Window.whole(grid.rows.cells, grid.columns.cells)
        for index, level in enumerate(differences):
            blurred = blur.apply(level)
            slope = cost_slope(blurred, scales.p, self.tonal.tie, weight)
            self.costs[extent.scale] += float(sum_of_costs(blurred, slope, scales.p))
            if self._pulled:
                tally.sums[0] += misplaced(blurred, grid, whole, self.tonal.tie)
                self._pulled[extent.start - 1][index] += blur.adjoint(slope)
        if self._pulled:
            self.misplaced.append(Misplaced.of(tally, 0, grid.cells, scales=scales, beta=self.tonal.beta))

    @property
    def _pixels(self) -> int:
        return sum(tile.cells for tile in self.tiles)

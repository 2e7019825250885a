"""One plane and a reference, compared tile by tile at all scales."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loi_core.method.blurs import PlaneGrid
from loi_core.method.comparison import ScaleKey
from loi_core.method.gaussian import reach
from loi_core.method.planner import make_plan
from loi_core.method.sampling_error import Misplaced
from loi_core.method.scales import ScaleSpace
from loi_core.method.tiled.coarse import Pyramid, is_wide, tiles_of
from loi_core.method.tiled.inner import Inner, NarrowlyBlurred, TiledPlane, Unblurred, WidelyBlurred
from loi_core.method.tiled.narrow import NarrowBlur, NarrowComparison
from loi_core.method.tiled.tonal import TonalScale
from loi_core.method.tiled.turns import in_order
from loi_core.method.tiled.wide import WideComparison
from loi_core.method.windows import Window
from loi_core.support.arrays import Host

__all__ = ["Tiled", "TiledComparison"]


@dataclass
class Tiled:
    """What comes of comparing a plane."""

    terms: dict[ScaleKey, float]
    misplaced: list[Misplaced] = field(default_factory=list)


@dataclass(frozen=True)
class TiledComparison:
    """How planes of one size are compared at some scales, tile by tile.

    Attributes
    ----------
    scales : ScaleSpace
    height, width : int
        Of a plane, in pixels.
    planes : int
        How many planes the mean is over.
    side : int
        Of a tile, in pixels.
    dtype : dtype
        float32 or float64.
    weighted : bool
        Whether pixels count by weights.
    """

    scales: ScaleSpace
    height: int
    width: int
    planes: int
    side: int
    dtype: np.dtype[Any]
    weighted: bool = False

    @functools.cached_property
    def tiles(self) -> list[Window]:
        """The tiles of a plane, row by row."""
        return tiles_of(self.height, self.width, self.side)

    def compare(self, plane: TiledPlane, *, tolerance: float, gradient: bool) -> Tiled:
        """Compare one plane, and add to its cotangent."""
        found = Tiled(dict.fromkeys(self.scales.keys, 0.0))
        for sigma in self.scales.sigma:
            inner = self._inner(sigma, plane)
            for beta in self.scales.beta:
                self._compare(sigma, beta, plane, inner, found, tolerance=tolerance, gradient=gradient)
            if gradient:
                inner.finish()
        return found

    def _compare(
        self,
        sigma: float,
        beta: float,
        plane: TiledPlane,
        inner: Inner,
        found: Tiled,
        *,
        tolerance: float,
        gradient: bool,
    ) -> None:
        wide, narrow = self._extents
        far = near = None
        if wide:
            tonal = TonalScale.of(self.scales, beta, self.dtype)
            samplings = self._samplings(sigma, tolerance)
            far = WideComparison(tonal, self._pyramid(wide), self.tiles, self.planes, samplings, self.dtype)

            def gather(tile: Window, far: WideComparison = far) -> tuple[Window, Host] | None:
                return far.gathered(tile, inner.image(tile), inner.reference(tile), plane.shares(tile))

            for gathered in in_order(functools.partial(gather, tile) for tile in self.tiles):
                far.add(gathered)
            far.compare(gradient=gradient)
            found.misplaced += far.misplaced
            for alpha, cost in far.costs.items():
                found.terms[alpha, beta, sigma] += cost
        if narrow:
            near = NarrowComparison(self.scales, narrow, beta, self.height, self.width, self.planes, self._eps)
        if not (gradient or near):
            return

        def look(tile: Window) -> tuple[dict[float, float], tuple[Window, Host] | None]:
            costs: dict[float, float] = {}
            total, window = None, tile
            if near is not None:
                window = near.seen(tile)
                ours, theirs = inner.image(window), inner.reference(window)
                costs, total = near.compare(tile, ours, theirs, plane.shares(window), gradient=gradient)
            if gradient and far is not None:
                back = far.pulled(tile, inner.image(tile), plane.shares(tile))
                if total is None:
                    total = back
                else:
                    inside = tile.seen_from(window).crop(total)
                    inside += back
            return costs, None if total is None else inner.pulled_back(window, total)

        for costs, part in in_order(functools.partial(look, tile) for tile in self.tiles):
            for alpha, cost in costs.items():
                found.terms[alpha, beta, sigma] += cost
            if part is not None:
                inner.add(*part)

    @property
    def _eps(self) -> float:
        return float(np.finfo(self.dtype).eps)

    @functools.cached_property
    def _extents(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The wide ones and the narrow ones."""
        wide = tuple(alpha for alpha in self.scales.alpha if self._is_wide(alpha, self.scales.extent_taps))
        return wide, tuple(alpha for alpha in self.scales.alpha if alpha not in wide)

    def _is_wide(self, scale: float, taps: int | None) -> bool:
        if taps is not None and taps // 2 >= reach(self._eps) * scale:
            taps = None  # it is cut beyond what rounding leaves of it
        return is_wide(scale, taps, max(self.height, self.width), self._eps)

    def _pyramid(self, wide: tuple[float, ...]) -> Pyramid:
        return Pyramid.of(self.scales, wide, self.height, self.width, self._eps)

    def _inner(self, sigma: float, plane: TiledPlane) -> Inner:
        taps = self.scales.inner_taps
        if sigma == 0.0:
            return Unblurred(plane)
        if self._is_wide(sigma, taps):
            return WidelyBlurred(plane, self._pyramid((sigma,)), self.tiles, self.dtype)
        return NarrowlyBlurred(plane, NarrowBlur(sigma, taps, self.scales, self.height, self.width, self._eps))

    def _samplings(self, sigma: float, tolerance: float) -> dict[float, PlaneGrid]:
        """Where wide extents are compared, if not at every pixel."""
        if tolerance == 0.0 or self.scales.boundary != "reflect":
            return {}
        wide, _ = self._extents
        size = self.height, self.width
        plan = make_plan(self.scales, *size, tolerance=tolerance, eps=self._eps, weighted=self.weighted)
        (inner,) = (each for each in plan.inner if each.sigma == sigma)
        return {each.alpha: each.blur.target for each in inner.extents if each.is_sampled and each.alpha in wide}

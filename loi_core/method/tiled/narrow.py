"""Narrow kernels of one tile, which see no further than a halo around it."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

from loi_core.method.blurs import Blur, PlaneBlur, PlaneGrid
from loi_core.method.dispatch import choose_backend, plane_blur
from loi_core.method.gaussian import AxisBlur, reach
from loi_core.method.plan import Plan
from loi_core.method.planner import make_plan
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window
from loi_core.support.arrays import Host

__all__ = ["NarrowBlur", "NarrowComparison", "halo"]


def halo(scale: float, taps: int | None, eps: float) -> int:
    """How many pixels away a kernel sees."""
    return math.ceil(reach(eps) * scale) if taps is None else taps // 2 + 1


@dataclass(frozen=True)
class NarrowBlur:
    """A blur of planes of one size, tile by tile.

    Attributes
    ----------
    scale : float
    taps : int or None
        Where the kernel is cut.
    scales : ScaleSpace
        Its boundary is that of the blur.
    height, width : int
    eps : float
    """

    scale: float
    taps: int | None
    scales: ScaleSpace
    height: int
    width: int
    eps: float

    def seen(self, tile: Window) -> Window:
        """A tile with its halo."""
        return tile.grown(halo(self.scale, self.taps, self.eps), self.height, self.width)

    def apply(self, part: Host, tile: Window) -> Host:
        """The blurred tile, of the part of the plane that it sees."""
        seen = self.seen(tile)
        blurred: Host = tile.seen_from(seen).crop(self._blur(seen, part).apply(part))
        return blurred

    def adjoint(self, cotangent: Host, tile: Window) -> Host:
        """The transpose of :meth:`apply`: of a tile to what it sees."""
        seen = self.seen(tile)
        pulled: Host = self._blur(seen, cotangent).adjoint(tile.seen_from(seen).paste(cotangent, *seen.shape))
        return pulled

    def _blur(self, seen: Window, like: Host) -> Blur:
        grid, cut = PlaneGrid.pixels(*seen.shape), reach(self.eps)
        rows, columns = (
            AxisBlur(axis, axis, self.scale, self.scales.boundary, self.taps, cut) for axis in (grid.rows, grid.columns)
        )
        return plane_blur(PlaneBlur(rows, columns), like)


@dataclass(frozen=True)
class NarrowComparison:
    """Some narrow extents at one tonal scale, on planes of one size, tile by tile.

    Attributes
    ----------
    scales : ScaleSpace
        Of what is compared, of which the extents are `narrow` and the tonal scale is `beta`.
    narrow : tuple of float
    beta : float
    height, width : int
    planes : int
        How many planes the mean is over.
    eps : float
    """

    scales: ScaleSpace
    narrow: tuple[float, ...]
    beta: float
    height: int
    width: int
    planes: int
    eps: float

    def seen(self, tile: Window) -> Window:
        """A tile with its halo."""
        reached = max(halo(scale, self.scales.extent_taps, self.eps) for scale in self.narrow)
        return tile.grown(reached, self.height, self.width)

    def compare(
        self, tile: Window, image: Host, reference: Host, shares: Host, *, gradient: bool
    ) -> tuple[dict[float, float], Host | None]:
        """What each extent costs at the pixels of a tile, and the cotangent by all that it sees.

        Parameters
        ----------
        tile : Window
        image, reference : array
            Intensities above the padding of what the tile sees.
        shares : array
            How much each of these counts; empty if all count alike.
        gradient : bool
        """
        seen = self.seen(tile)
        scales, plan = _plan(self.scales, self.narrow, self.beta, seen.shape, tile.seen_from(seen), self.eps)
        weights = shares[None] if shares.size else None
        comparison = choose_backend(image).comparison(scales, plan, reference[None], weights)
        compared = comparison.compare(image[None], gradient=gradient)
        # The mean is over all of the plane, and over all planes.
        part = seen.cells / (self.height * self.width * self.planes) * (self.scales.scale_weight / scales.scale_weight)
        costs = {alpha: float(cost) * part for (alpha, _, _), cost in compared.terms.items()}
        return costs, None if compared.cotangent is None else compared.cotangent[0] * image.dtype.type(part)


@functools.lru_cache(maxsize=64)
def _plan(
    scales: ScaleSpace, narrow: tuple[float, ...], beta: float, shape: tuple[int, int], compared: Window, eps: float
) -> tuple[ScaleSpace, Plan]:
    """The scales and the exact plan of a part of a plane, already blurred and above the padding."""
    low, high = (bound - scales.padding for bound in scales.bounds)
    here = ScaleSpace(
        0.0,
        narrow,
        beta,
        (low, high),
        scales.boundary,
        p=scales.p,
        tails=scales.tails,
        convention=scales.convention,
        kernel_size=scales.kernel_size,
    )
    plan = make_plan(here, *shape, tolerance=0.0, eps=eps)
    inner = tuple(
        replace(each, extents=tuple(replace(extent, compared=compared) for extent in each.extents))
        for each in plan.inner
    )
    return here, replace(plan, inner=inner)

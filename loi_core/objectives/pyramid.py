"""The multi-scale baseline: squared differences at every level of a Gaussian pyramid (Adelson et al. 1984)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from loi_core.errors import OptionError
from loi_core.method.blurs import DenseBlur
from loi_core.method.gaussian import blur_matrix
from loi_core.objectives.base import ImageObjective
from loi_core.objectives.evaluation import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, from_numpy, sum_of_all
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["GaussianPyramid"]

REDUCE_SIGMA: Final = 1.0  # pixels: standard deviation of the binomial kernel (1, 4, 6, 4, 1) / 16 of a pyramid


@suggest_keywords
class GaussianPyramid(ImageObjective[int]):
    """Sum over pyramid levels of the mean squared difference at that level.

    Each level is the previous level blurred by a Gaussian of one pixel, with reflection at the border, and subsampled
    by two. Weights of pixels are reduced in the same way.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point; see :class:`ImageObjective`, as for `channel_axis`, `nan_policy`, `tone` and `weights`.
    levels : int, optional
        Number of levels, the full resolution included; by default, down to a shorter side of 2 pixels.
    """

    takes_weights: ClassVar[bool] = True

    def __init__(
        self,
        reference: Array,
        levels: int | None = None,
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone, weights=weights)
        shorter = min(self._reference_layout.height, self._reference_layout.width)
        max_levels = max(1, int(math.log2(shorter)))
        if levels is None:
            levels = max_levels
        count = whole_number(levels)
        if count is None or not 1 <= count <= max_levels:
            msg = f"`levels` must be a whole number from 1 to {max_levels} for this image size, got {shown(levels)}"
            raise OptionError(msg)
        self._levels = count

    def _facts(self) -> dict[str, str]:
        return super()._facts() | {"levels": str(self._levels)}

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[int]:
        """See :class:`loi_core.ImageObjective`."""
        height, width = reference.planes.shape[-2:]
        reductions, levels, weights = [], [reference.planes], [reference.weights]
        for _ in range(self._levels - 1):
            rows = blur_matrix(height, REDUCE_SIGMA, "reflect")[::2]
            columns = blur_matrix(width, REDUCE_SIGMA, "reflect")[::2]
            reduction = DenseBlur(from_numpy(rows, reference.planes), from_numpy(columns, reference.planes))
            reductions.append(reduction)
            levels.append(reduction.apply(levels[-1]))
            weights.append(None if weights[-1] is None else reduction.apply(weights[-1]))
            height, width = rows.shape[0], columns.shape[0]
        return _PyramidComparison(reductions, levels, None if reference.weights is None else weights)


@dataclass(frozen=True, eq=False)
class _PyramidComparison(PlaneComparison[int]):
    """The reference's pyramid, and the reductions from each level to the next."""

    reductions: list[DenseBlur]
    levels: list[Array]
    weights: list[Array] | None  # of the pixels of each level; None if all count alike

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[int]:
        # The pyramid is linear: the pyramid of the difference is the difference of the pyramids.
        differences = [planes - self.levels[0]]
        for reduction in self.reductions:
            differences.append(reduction.apply(differences[-1]))
        weighted = differences
        if self.weights is not None:
            weighted = [level * weights for level, weights in zip(differences, self.weights, strict=True)]
        factors = [1.0 / math.prod(level.shape) for level in differences]
        terms = {
            index: sum_of_all(difference * product) * factor
            for index, (difference, product, factor) in enumerate(zip(differences, weighted, factors, strict=True))
        }
        if not gradient:
            return Evaluation(terms, None)
        cotangent = weighted[-1] * (2.0 * factors[-1])
        finer = zip(weighted[-2::-1], factors[-2::-1], reversed(self.reductions), strict=True)
        for level, factor, reduction in finer:
            cotangent = level * (2.0 * factor) + reduction.adjoint(cotangent)
        return Evaluation(terms, cotangent)

"""The multi-scale baseline: squared differences at every level of a Gaussian pyramid (Adelson et al. 1984)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from loi_core.errors import OptionError
from loi_core.method.blurs import DenseBlur
from loi_core.method.gaussian import blur_matrix
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, from_numpy, sum_of_all
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["GaussianPyramid"]

REDUCE_SCALE = 1.0  # standard deviation of the binomial (1, 4, 6, 4, 1) / 16 that a pyramid blurs with


@dataclass(frozen=True)
class _Prepared:
    reductions: list[DenseBlur]
    levels: list[Array]
    weights: list[Array] | None  # of the pixels of each level, if they do not all count alike


class GaussianPyramid(ImageObjective[_Prepared, int]):
    """Sum over pyramid levels of the mean squared difference at that level.

    Each level is the one before, blurred by a Gaussian of one pixel under reflection and halved; weights of pixels are
    blurred and halved with it.

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
        most = max(1, int(math.log2(shorter)))
        if levels is None:
            levels = most
        count = whole_number(levels)
        if count is None or not 1 <= count <= most:
            msg = f"`levels` must be a whole number from 1 to {most} for this image size, got {shown(levels)}"
            raise OptionError(msg)
        self._levels = count

    def _facts(self) -> dict[str, str]:
        return super()._facts() | {"levels": str(self._levels)}

    def prepare_reference(self, reference: Array, weights: Array | None) -> _Prepared:
        """See :class:`loi_core.ImageObjective`."""
        height, width = reference.shape[-2:]
        reductions, levels, shares = [], [reference], [weights]
        for _ in range(self._levels - 1):
            rows = blur_matrix(height, REDUCE_SCALE, "reflect")[::2]
            columns = blur_matrix(width, REDUCE_SCALE, "reflect")[::2]
            reductions.append(DenseBlur(from_numpy(rows, reference), from_numpy(columns, reference)))
            levels.append(reductions[-1].apply(levels[-1]))
            shares.append(None if shares[-1] is None else reductions[-1].apply(shares[-1]))
            height, width = rows.shape[0], columns.shape[0]
        return _Prepared(reductions, levels, None if weights is None else shares)

    def compare_planes(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[int]:
        """See :class:`loi_core.ImageObjective`."""
        # The pyramid is linear: the pyramid of the difference is the difference of the pyramids.
        differences = [planes - prepared.levels[0]]
        for reduction in prepared.reductions:
            differences.append(reduction.apply(differences[-1]))
        weighted = differences
        if prepared.weights is not None:
            weighted = [level * share for level, share in zip(differences, prepared.weights, strict=True)]
        per_pixel = [1.0 / math.prod(level.shape) for level in differences]
        terms = {
            index: sum_of_all(one * other) * weight
            for index, (one, other, weight) in enumerate(zip(differences, weighted, per_pixel, strict=True))
        }
        if not gradient:
            return Evaluation(terms, None)
        cotangent = weighted[-1] * (2.0 * per_pixel[-1])
        for level, weight, reduction in zip(
            weighted[-2::-1], per_pixel[-2::-1], reversed(prepared.reductions), strict=True
        ):
            cotangent = level * (2.0 * weight) + reduction.adjoint(cotangent)
        return Evaluation(terms, cotangent)

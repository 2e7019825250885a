"""What each scale alone asks of an image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from loi_core.method.comparison import ScaleKey
from loi_core.objectives.loi import LOIObjective
from loi_core.support.arrays import Array

__all__ = ["gradients_by_scale"]


def gradients_by_scale(objective: LOIObjective, image: Array) -> Iterator[tuple[ScaleKey, Array]]:
    """The gradient of every scale's part of the loss by the image, by (alpha, beta, sigma); they sum to the loss's own.

    Errors as in :meth:`LOIObjective.value_and_grad`.
    """
    for key in objective.scales.keys:
        alpha, beta, sigma = key
        alone = objective.with_scales(replace(objective.scales, alpha=(alpha,), beta=(beta,), sigma=(sigma,)))
        yield key, alone.value_and_grad(image)[1]

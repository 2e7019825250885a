"""All measurements of a pair of images."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from loi_core.inspection.maps import loss_maps
from loi_core.inspection.pair import Pair
from loi_core.inspection.reach import Reach, Shifts, reach_of_object, shifts_of_picture
from loi_core.io.images import FloatImage
from loi_core.method.comparison import ScaleKey
from loi_core.objectives.loi import LOIObjective, gradients_by_scale
from loi_core.pixels.bounds import RangeWarning

__all__ = ["Findings", "ScaleFindings", "inspect_pair"]


@dataclass(frozen=True)
class ScaleFindings:
    """The measurements of one scale.

    Attributes
    ----------
    key : (float, float, float)
        alpha, beta and sigma, in pixels of the files and in intensity.
    value, share : float
        The contribution to the loss, and its fraction of the loss; 0 if the loss is 0.
    loss : array, shape (h, w)
        The distance of eq. 5 at every pixel; its mean is `value`.
    gradient : array, shape (h, w, C)
        The gradient of `value` with respect to the image.
    reach : Reach
        The largest distance of a single small object that is still drawn back.
    rise : Reach
        How far the reference may be shifted against itself while its own loss rises.
    """

    key: ScaleKey
    value: float
    share: float
    loss: FloatImage
    gradient: FloatImage
    reach: Reach
    rise: Reach

    def plain(self) -> dict[str, Any]:
        """Return all numbers as plain values for JSON."""
        alpha, beta, sigma = self.key
        return {
            "alpha": alpha,
            "beta": beta,
            "sigma": sigma,
            "value": self.value,
            "share": self.share,
            "largest_distance": float(self.loss.max()),
            "gradient_norm": float(np.linalg.norm(self.gradient)),
            "reach_of_object": asdict(self.reach),
            "reach_of_picture": asdict(self.rise),
        }


@dataclass(frozen=True)
class Findings:
    """A pair, its loss, the measurements of each scale, and the loss of its shifted reference."""

    pair: Pair
    value: float
    scales: tuple[ScaleFindings, ...]
    shifts: Shifts

    def plain(self) -> dict[str, Any]:
        """Return all numbers as plain values for JSON."""
        pair = self.pair
        return {
            "image": pair.names[0],
            "reference": pair.names[1],
            "height": pair.height,
            "width": pair.width,
            "channels": pair.image.shape[2],
            "averaged_over": pair.factor,
            "shift": pair.shift,
            "value": self.value,
            "why": pair.scales.describe(pair.height, pair.width).splitlines(),
            "scales": [scale.plain() for scale in self.scales],
            "notes": list(pair.notes),
        }


def inspect_pair(pair: Pair) -> Findings:
    """Measure the loss of a pair at each scale."""
    image, reference, scales = pair.image, pair.reference, pair.computed_scales
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RangeWarning)  # it is among the notes of the pair
        maps = loss_maps(image, reference, scales)
        gradients = dict(gradients_by_scale(LOIObjective(reference, scales), image))
        reaches = reach_of_object(pair.scales, pair.height, pair.width)
        shifts = shifts_of_picture(reference, pair.scales, pair.factor)
    values = {key: float(np.mean(loss)) for key, loss in maps.items()}
    total = sum(values.values())
    return Findings(
        pair,
        total,
        tuple(
            ScaleFindings(
                key,
                values[computed],
                values[computed] / total if total > 0.0 else 0.0,
                maps[computed],
                gradients[computed],
                reaches[key],
                shifts.rises[key],
            )
            for key, computed in zip(pair.scales.keys, scales.keys, strict=True)
        ),
        shifts,
    )

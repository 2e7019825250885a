"""All that is found out about a pair, as numbers."""

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
from loi_core.objectives.by_scale import gradients_by_scale
from loi_core.objectives.loi import LOIObjective
from loi_core.pixels.bounds import RangeWarning

__all__ = ["Findings", "ScaleFindings", "inspect_pair"]


@dataclass(frozen=True)
class ScaleFindings:
    """One scale.

    Attributes
    ----------
    key : (float, float, float)
        alpha, beta and sigma, in pixels of the files and in intensity.
    value, share : float
        What it adds to the loss, and what part of the loss that is; 0 if the loss is 0.
    loss : array, shape (h, w)
        The distance of eq. 5 at every pixel; its mean is `value`.
    gradient : array, shape (h, w, C)
        Of `value` by the image.
    reach : Reach
        How far away a small object alone is drawn back from.
    rise : Reach
        How far the reference may be moved against itself, and its own loss rises all the way.
    """

    key: ScaleKey
    value: float
    share: float
    loss: FloatImage
    gradient: FloatImage
    reach: Reach
    rise: Reach


@dataclass(frozen=True)
class Findings:
    """A pair, its loss, and what each scale has to do with it."""

    pair: Pair
    value: float
    scales: tuple[ScaleFindings, ...]
    shifts: Shifts

    def plain(self) -> dict[str, Any]:
        """All numbers as plain values for JSON."""
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
            "scales": [_plain(one) for one in self.scales],
            "notes": list(pair.notes),
        }


def inspect_pair(pair: Pair) -> Findings:
    """Find out what each scale sees in a pair."""
    ours, theirs, scales = pair.image, pair.reference, pair.computed_scales
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RangeWarning)  # it is among the notes of the pair
        maps = loss_maps(ours, theirs, scales)
        slopes = dict(gradients_by_scale(LOIObjective(theirs, scales), ours))
        reaches = reach_of_object(pair.scales, pair.height, pair.width)
        shifts = shifts_of_picture(theirs, pair.scales, pair.factor)
    values = {key: float(np.mean(found)) for key, found in maps.items()}
    total = sum(values.values())
    return Findings(
        pair,
        total,
        tuple(
            ScaleFindings(
                key,
                values[here],
                values[here] / total if total > 0.0 else 0.0,
                maps[here],
                slopes[here],
                reaches[key],
                shifts.rises[key],
            )
            for key, here in zip(pair.scales.keys, scales.keys, strict=True)
        ),
        shifts,
    )


def _plain(one: ScaleFindings) -> dict[str, Any]:
    alpha, beta, sigma = one.key
    return {
        "alpha": alpha,
        "beta": beta,
        "sigma": sigma,
        "value": one.value,
        "share": one.share,
        "largest_distance": float(one.loss.max()),
        "gradient_norm": float(np.linalg.norm(one.gradient)),
        "reach_of_object": asdict(one.reach),
        "reach_of_picture": asdict(one.rise),
    }

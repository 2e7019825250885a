"""How far a step of a fit moves each parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from loi_core.fitting.parameters import Bounds
from loi_core.fitting.views import Views
from loi_core.objectives import ImageObjective, Objective
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import measure_units, pixels_of
from loi_core.support.arrays import Array
from loi_core.support.values import real_number

__all__ = ["measured_rates", "named_rates"]

CROSSINGS: Final = 2.0  # of the longer side by all steps, if none decayed: once with the decay
LEAST_PIXELS: Final = 0.25  # a step
MOST_PIXELS: Final = 1.0 / 16.0  # of the longer side, a step


def named_rates(asked: Mapping[str, float | str | None]) -> dict[str, float | str]:
    """Rates as they were asked for; those that are left to the library by name."""
    named = {name: "auto" if rate is None else rate for name, rate in asked.items()}
    return {name: rate if isinstance(rate, str) else real_number(rate) for name, rate in named.items()}


def measured_rates(
    views: Views,
    params: Parameters,
    bounds: Bounds,
    asked: Mapping[str, float | str | None],
    steps: int,
    seed: int,
) -> dict[str, float]:
    """How far a step moves each parameter, in its own unit; where pixels were asked for, as measured at `params`."""
    in_pixels = [name for name, rate in asked.items() if rate is None or isinstance(rate, str)]
    units: dict[str, float] = {}
    if in_pixels:
        each = list(views.each.values())
        units, side = measure_units(
            each, params, bounds, in_pixels, targets=[_target(view.objectives[-1]) for view in each], seed=seed
        )
        least, most = LEAST_PIXELS, side * MOST_PIXELS
        usual = min(max(CROSSINGS * side / steps, least), max(most, least))
    rates = {}
    for name, rate in asked.items():
        if name in units:
            pixels = usual if rate is None else pixels_of(rate)
            # What leaves no trace has no unit, and no gradient either: any rate will do.
            rates[name] = pixels * units[name] if math.isfinite(units[name]) else 1.0
        else:
            rates[name] = real_number(rate)
    return rates


def _target(objective: Objective) -> Array | None:
    """What an image is compared with, shape (H, W, C), if that is known."""
    if isinstance(objective, ImageObjective) and objective.channel_axis == -1:
        return objective.reference
    return None

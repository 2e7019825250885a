"""Learning rates of the free parameters, each in its own unit."""

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

__all__ = ["measured_rates", "named_rates", "racing_factors"]

CROSSINGS: Final = 2.0  # of the longer side of the image by all steps without decay: one crossing with decay
MIN_RATE_PX: Final = 0.25
MAX_RATE_FRACTION: Final = 1.0 / 16.0  # of the longer side


def named_rates(requested: Mapping[str, float | str | None]) -> dict[str, float | str]:
    """Return the requested rates: numbers, text in pixels, or "auto" where the library chooses."""
    return {
        name: "auto" if rate is None else rate if isinstance(rate, str) else real_number(rate)
        for name, rate in requested.items()
    }


def measured_rates(
    views: Views,
    params: Parameters,
    bounds: Bounds,
    requested: Mapping[str, float | str | None],
    steps: int,
    seed: int,
) -> dict[str, float]:
    """Return the rate of each parameter in its own unit; rates in pixels are converted as measured at `params`."""
    in_pixels = [name for name, rate in requested.items() if rate is None or isinstance(rate, str)]
    units: dict[str, float] = {}
    if in_pixels:
        all_views = list(views.by_name.values())
        units, image_side = measure_units(
            all_views,
            params,
            bounds,
            in_pixels,
            targets=[_reference_of(view.objectives[-1]) for view in all_views],
            seed=seed,
        )
        max_pixels = max(image_side * MAX_RATE_FRACTION, MIN_RATE_PX)
        default_pixels = min(max(CROSSINGS * image_side / steps, MIN_RATE_PX), max_pixels)
    rates = {}
    for name, rate in requested.items():
        if name in units:
            pixels = default_pixels if rate is None else pixels_of(rate)
            # A parameter that does not change the image has no unit and no gradient: any rate will do.
            rates[name] = pixels * units[name] if math.isfinite(units[name]) else 1.0
        else:
            rates[name] = real_number(rate)
    return rates


def _reference_of(objective: Objective) -> Array | None:
    """Return the reference image, shape (H, W, C), if it is known."""
    if isinstance(objective, ImageObjective) and objective.channel_axis == -1:
        return objective.reference
    return None


def racing_factors(requested: Mapping[str, float | str | None], steps: int) -> dict[str, float]:
    """Return how much faster each parameter may move in a race than in a fit; rates that were asked for stay."""
    fastest = max(MAX_RATE_FRACTION / min(CROSSINGS / steps, MAX_RATE_FRACTION), 1.0)
    return {name: fastest if rate is None else 1.0 for name, rate in requested.items()}

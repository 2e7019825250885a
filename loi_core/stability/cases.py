"""The catalogue of hard cases: what renders and users hand to a loss when it is needed most, each with a name."""

from __future__ import annotations

import functools

from loi_core.stability.array_cases import array_cases, batch_cases, tie_cases
from loi_core.stability.case import HardCase
from loi_core.stability.pixel_cases import bad_pixel_cases, equal_image_cases, range_cases
from loi_core.stability.scale_cases import scale_cases, size_cases

__all__ = ["hard_cases"]


@functools.cache
def hard_cases() -> tuple[HardCase, ...]:
    """All of them, in the order in which they are reported."""
    return (
        *equal_image_cases(),
        *range_cases(),
        *bad_pixel_cases(),
        *scale_cases(),
        *size_cases(),
        *tie_cases(),
        *batch_cases(),
        *array_cases(),
    )

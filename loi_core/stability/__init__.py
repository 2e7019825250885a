"""The catalogue of numerically hard cases, the errors that are allowed there, and how backends stand up to them."""

from loi_core.stability.bounds import Allowed, allowed
from loi_core.stability.case import HardCase
from loi_core.stability.cases import hard_cases
from loi_core.stability.rows import PROPERTIES, StabilityProperty, StabilityRow, stability_rows

__all__ = [
    "PROPERTIES",
    "Allowed",
    "HardCase",
    "StabilityProperty",
    "StabilityRow",
    "allowed",
    "hard_cases",
    "stability_rows",
]

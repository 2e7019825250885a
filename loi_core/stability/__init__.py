"""The catalogue of numerically hard cases, derived error bounds for them, and their results on every backend."""

from loi_core.stability.bounds import Allowed, allowed
from loi_core.stability.case import HardCase
from loi_core.stability.cases import hard_cases
from loi_core.stability.rows import StabilityRow, stability_rows
from loi_core.stability.rules import STABILITY_CHECKS

__all__ = ["STABILITY_CHECKS", "Allowed", "HardCase", "StabilityRow", "allowed", "hard_cases", "stability_rows"]

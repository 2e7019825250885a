"""Sweeps: many fits of scene files in parallel, summarised in one table and one page."""

from loi_core.sweeps.leaderboard import Standing
from loi_core.sweeps.run import SweepResult, sweep

__all__ = ["Standing", "SweepResult", "sweep"]

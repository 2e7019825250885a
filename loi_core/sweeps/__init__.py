"""Sweeps: many fits of scene files, side by side, in one table and on one page."""

from loi_core.sweeps.leaderboard import Standing
from loi_core.sweeps.run import SweepResult, sweep

__all__ = ["Standing", "SweepResult", "sweep"]

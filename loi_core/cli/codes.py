"""The exit codes of ``loi``."""

from __future__ import annotations

from typing import Final

__all__ = ["DONE", "FAILED", "NOT_FOUND", "WRONG_CALL"]

DONE: Final = 0
FAILED: Final = 1  # the work failed or was interrupted; partial results are kept
WRONG_CALL: Final = 2
NOT_FOUND: Final = 3  # a fit ran to its end and did not find its target

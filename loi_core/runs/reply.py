"""What a process answers for a run."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Reply"]


@dataclass(frozen=True)
class Reply:
    """How a run ended, in bytes and text alone: whoever passes it on need not be able to read its value.

    Attributes
    ----------
    value : bytes
        What the run gave, pickled; None if it gave nothing.
    cause : str
        Why it gave nothing, on one line.
    details : str
        A traceback, or the last that its process wrote to standard error.
    died : bool
        Whether its process ended by itself, or by somebody else's hand.
    """

    value: bytes | None = None
    cause: str = ""
    details: str = ""
    died: bool = False

"""What came of a fit, as its result says it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

__all__ = ["Diagnosis", "Verdict"]

Verdict: TypeAlias = Literal[
    "converged",
    "stalled",
    "still falling",
    "at a bound",
    "no gradient",
    "follows noise",
    "left the frame",
    "other range",
]


@dataclass(frozen=True)
class Diagnosis:
    """What came of a fit.

    Attributes
    ----------
    verdict : str
        "converged": little is left of the loss, once noise is averaged away. "stalled": it is not, and no longer
        falls. "still falling": more steps would help. "at a bound", "no gradient", "left the frame" (the gradient was
        there and is gone), "follows noise", "other range" (target and render differ in brightness as if one were
        encoded): why it did not get further.
    message : str
        One line on what was seen.
    advice : str
        One line on what to try; empty if nothing needs to be.
    left : float
        Of the loss at the start, what is left.
    noise : float
        Of the loss at the start, what a render of the result differs by from the mean of others.
    """

    verdict: Verdict
    message: str
    advice: str = ""
    left: float = float("nan")
    noise: float = float("nan")

    @property
    def ok(self) -> bool:
        """Whether the fit has found what it was to find, as far as the loss can tell."""
        return self.verdict == "converged"

    def __str__(self) -> str:
        return f"{self.verdict}: {self.message}" + (f"; {self.advice}" if self.advice else "")

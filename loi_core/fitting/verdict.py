"""The verdict on a fit, as its result reports it."""

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
    """The diagnosis of a fit.

    Attributes
    ----------
    verdict : str
        "converged": little is left of the loss, once noise is averaged away, or the pixels that the parameters move
        agree as well as those of a photograph and its render can. "stalled": more is left, and the loss no longer
        falls. "still falling": more steps would help. "at a bound", "no gradient", "left the frame" (the gradient has
        vanished), "follows noise", "other range" (target and render differ in brightness as if one were encoded): the
        reason why the fit stopped short.
    message : str
        The observation, in one line.
    advice : str
        A remedy, in one line; empty if none is needed.
    left : float
        Remaining loss, as a fraction of the loss at the start.
    noise : float
        Loss between one render of the result and the mean of several, as a fraction of the loss at the start.
    """

    verdict: Verdict
    message: str
    advice: str = ""
    left: float = float("nan")
    noise: float = float("nan")

    @property
    def ok(self) -> bool:
        """Whether the fit has found its target, as far as the loss shows."""
        return self.verdict == "converged"

    def __str__(self) -> str:
        return f"{self.verdict}: {self.message}" + (f"; {self.advice}" if self.advice else "")

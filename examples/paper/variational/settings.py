"""How a fit is done: by which loss, at which rate, with which blur of the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from loi_core import ScaleSpace

__all__ = ["CHOSEN", "INNER", "LABELS", "PAIRS", "PAPER_SCALES", "RATES", "SIGMAS", "Method", "Name", "Setting", "Size"]

Method = Literal["pixels", "sigma", "paper", "default"]
Name = Literal["kaleidoscope", "orb"]

LABELS: Final[dict[Method, str]] = {
    "pixels": "pixels (PRDPT alone)",
    "sigma": "sigma only",
    "paper": "loi, the paper's scales",
    "default": "loi, our scales",
}
PAPER_SCALES: Final = ScaleSpace.paper("path")
INNER: Final = PAPER_SCALES.sigma
PAIRS: Final = 4  # of images a step
LAST: Final = 0.4  # what is left of the blur of the parameters at the end


@dataclass(frozen=True)
class Setting:
    """One way to fit.

    Attributes
    ----------
    method : str
        Which objective.
    rate, sigma : float
        Adam's rate and the standard deviation of the blur, as shares of each parameter's range.
    final : float
        Share of `sigma` with which the fit ends; it falls over the second half.
    """

    method: Method
    rate: float
    sigma: float
    final: float = LAST


@dataclass(frozen=True)
class Size:
    """How large a fit is: pixels along a side, samples a pixel, steps."""

    side: int
    samples: int
    steps: int


# Shares of the range that are searched over; those chosen are the best of each method, on a start that no table has.
RATES: Final[dict[Name, tuple[float, ...]]] = {"kaleidoscope": (0.02, 0.04), "orb": (0.01, 0.03)}
SIGMAS: Final[dict[Name, tuple[float, ...]]] = {"kaleidoscope": (0.05, 0.1), "orb": (0.05, 0.15)}
CHOSEN: Final[dict[Name, dict[Method, tuple[float, float]]]] = {
    "kaleidoscope": {"pixels": (0.02, 0.1), "sigma": (0.02, 0.05), "paper": (0.04, 0.05), "default": (0.02, 0.05)},
    "orb": {"pixels": (0.03, 0.05), "sigma": (0.03, 0.05), "paper": (0.03, 0.05), "default": (0.01, 0.15)},
}
SIZES: Final[dict[Name, Size]] = {"kaleidoscope": Size(100, 4, 120), "orb": Size(128, 4, 100)}
QUICK: Final[dict[Name, Size]] = {"kaleidoscope": Size(32, 2, 4), "orb": Size(32, 2, 4)}

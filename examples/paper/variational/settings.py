"""Settings of the fits: the loss, the learning rate, and the blur over the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from loi_core import ScaleSpace

__all__ = [
    "CHOSEN",
    "INNER_SCALES",
    "LABELS",
    "PAIRS",
    "PAPER_SCALES",
    "RATES",
    "SIGMAS",
    "Method",
    "Name",
    "Setting",
    "Size",
]

Method = Literal["pixels", "sigma", "paper", "default"]
Name = Literal["kaleidoscope", "orb"]

LABELS: Final[dict[Method, str]] = {
    "pixels": "pixels (PRDPT alone)",
    "sigma": "sigma only",
    "paper": "loi, the paper's scales",
    "default": "loi, our scales",
}
PAPER_SCALES: Final = ScaleSpace.paper("path")
INNER_SCALES: Final = PAPER_SCALES.sigma
PAIRS: Final = 4  # of images per step
FINAL_SIGMA_SHARE: Final = 0.4  # of the blur over the parameters


@dataclass(frozen=True)
class Setting:
    """Settings of a fit.

    Attributes
    ----------
    method : str
        Name of the objective.
    rate, sigma : float
        Learning rate of Adam and standard deviation of the blur, as shares of each parameter's range.
    final : float
        Share of `sigma` at the end of the fit, which the blur approaches over the second half.
    """

    method: Method
    rate: float
    sigma: float
    final: float = FINAL_SIGMA_SHARE


@dataclass(frozen=True)
class Size:
    """Size of a fit: pixels along a side of the image, samples per pixel, steps."""

    side: int
    samples: int
    steps: int


# Shares of the range in the search, and the best of each method, for a start that no table contains.
RATES: Final[dict[Name, tuple[float, ...]]] = {"kaleidoscope": (0.02, 0.04), "orb": (0.01, 0.03)}
SIGMAS: Final[dict[Name, tuple[float, ...]]] = {"kaleidoscope": (0.05, 0.1), "orb": (0.05, 0.15)}
CHOSEN: Final[dict[Name, dict[Method, tuple[float, float]]]] = {
    "kaleidoscope": {"pixels": (0.02, 0.1), "sigma": (0.02, 0.05), "paper": (0.04, 0.05), "default": (0.02, 0.05)},
    "orb": {"pixels": (0.03, 0.05), "sigma": (0.03, 0.05), "paper": (0.03, 0.05), "default": (0.01, 0.15)},
}
SIZES: Final[dict[Name, Size]] = {"kaleidoscope": Size(100, 4, 120), "orb": Size(128, 4, 100)}
QUICK: Final[dict[Name, Size]] = {"kaleidoscope": Size(32, 2, 4), "orb": Size(32, 2, 4)}

"""What a hard case is, and the pair of images that most of them start from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from loi_core.method.scales import ScaleSpace
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.stability.pictures import SHAPE, render, single
from loi_core.support.arrays import Host

__all__ = ["SCALES", "HardCase", "Pair", "pair", "spoilt"]

Pair: TypeAlias = tuple[Host, Host]
"""An image and its reference."""

SCALES: Final = ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125)


@dataclass(frozen=True)
class HardCase:
    """One case that should not break anything.

    Attributes
    ----------
    name : str
        What it is called, in reports and on the command line.
    danger : str
        One line: what could go wrong.
    answer : str
        One line: what the library does.
    make : callable
        Makes the image and the reference, both float64, shape (*batch, H, W, C).
    scales : ScaleSpace
    nan_policy : {"raise", "mask"}
    error : type of exception, optional
        What must be raised; None if there must be an answer.
    layout : callable, optional
        How the image lies in memory, or what it holds in place of floats: from an array to another. Such an image is
        handed to the core as it is.
    half : bool
        Whether images of 16 bits are tried as well.
    """

    name: str
    danger: str
    answer: str
    make: Callable[[], Pair]
    scales: ScaleSpace = SCALES
    nan_policy: NanPolicy = "raise"
    error: type[Exception] | None = None
    layout: Callable[[Host], Host] | None = None
    half: bool = False

    def __str__(self) -> str:
        return self.name


def pair() -> Pair:
    """A disk, and the same disk elsewhere."""
    return render(0.35, 0.3), render(0.6, 0.7)


def spoilt(value: float, *, count: int = 1) -> Pair:
    """The usual pair, with some pixels of the image replaced."""
    image, reference = pair()
    for index in range(count):
        image[3 + 2 * index, (7 + 5 * index) % SHAPE[1], index % SHAPE[2]] = value
    return single(image), reference

"""Which settings of the loss are measured: a grid of accuracy and dtype, and one change at a time around its middle."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from loi_core.errors import ScaleError
from loi_core.method.scales import ScaleSpace
from loi_core.objectives.loi import ACCURACIES

__all__ = ["DEFAULT_ACCURACY", "Setting", "settings_of"]

DEFAULT_ACCURACY = "balanced"


@dataclass(frozen=True)
class Setting:
    """One way to compute the loss.

    Attributes
    ----------
    backend : str
        Name of the backend.
    accuracy, dtype : str
        As the objective takes them.
    scales : ScaleSpace
        What is compared.
    change : str
        How `scales` differ from those that were asked for; empty if they do not. With a change, it is another loss.
    """

    backend: str
    accuracy: str
    dtype: str
    scales: ScaleSpace
    change: str = ""

    @property
    def levels(self) -> int:
        """Number of tonal levels, of all tonal scales together."""
        return sum(map(self.scales.level_count, self.scales.beta))

    def __str__(self) -> str:
        return ", ".join(filter(None, (self.backend, self.accuracy, self.dtype, self.change)))


def settings_of(backend: str, dtypes: Sequence[str], scales: ScaleSpace) -> list[Setting]:
    """What to measure on one backend, of whose dtypes the first is the usual one."""
    grid = [Setting(backend, accuracy, dtype, scales) for accuracy in ACCURACIES for dtype in dtypes]
    return grid + [Setting(backend, DEFAULT_ACCURACY, dtypes[0], other, how) for other, how in _changes(scales)]


def _changes(scales: ScaleSpace) -> Iterator[tuple[ScaleSpace, str]]:
    for factor, how in ((0.5, "half beta"), (2.0, "twice beta")):
        with contextlib.suppress(ScaleError):  # so many, or so few, levels are not allowed
            yield replace(scales, beta=tuple(factor * beta for beta in scales.beta)), how
    for sigma in scales.sigma if len(scales.sigma) > 1 else ():
        yield replace(scales, sigma=_without(scales.sigma, sigma)), f"without sigma {sigma:g}"
    for alpha in scales.alpha if len(scales.alpha) > 1 else ():
        yield replace(scales, alpha=_without(scales.alpha, alpha)), f"without alpha {alpha:g}"


def _without(values: tuple[float, ...], left_out: float) -> tuple[float, ...]:
    return tuple(value for value in values if value != left_out)

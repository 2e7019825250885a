"""Measured settings of the loss: a grid of accuracy and dtype, and single changes of the scales."""

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
    """One setting of the loss.

    Attributes
    ----------
    backend : str
        Name of the backend.
    accuracy, dtype : str
        As in :class:`loi_core.LOIObjective`.
    scales : ScaleSpace
        The compared scales.
    change : str
        Difference of `scales` from the requested scales, which makes it another loss; empty if there is none.
    """

    backend: str
    accuracy: str
    dtype: str
    scales: ScaleSpace
    change: str = ""

    @property
    def levels(self) -> int:
        """Number of tonal levels, summed over the tonal scales."""
        return sum(map(self.scales.level_count, self.scales.beta))

    def __str__(self) -> str:
        return ", ".join(filter(None, (self.backend, self.accuracy, self.dtype, self.change)))


def settings_of(backend: str, dtypes: Sequence[str], scales: ScaleSpace) -> list[Setting]:
    """Return the settings to measure on a backend; the first of its dtypes is the default."""
    grid = [Setting(backend, accuracy, dtype, scales) for accuracy in ACCURACIES for dtype in dtypes]
    return grid + [Setting(backend, DEFAULT_ACCURACY, dtypes[0], changed, name) for changed, name in _changes(scales)]


def _changes(scales: ScaleSpace) -> Iterator[tuple[ScaleSpace, str]]:
    for factor, name in ((0.5, "half beta"), (2.0, "twice beta")):
        with contextlib.suppress(ScaleError):  # the number of levels may be out of range
            yield replace(scales, beta=tuple(factor * beta for beta in scales.beta)), name
    for sigma in scales.sigma if len(scales.sigma) > 1 else ():
        yield replace(scales, sigma=_without(scales.sigma, sigma)), f"without sigma {sigma:g}"
    for alpha in scales.alpha if len(scales.alpha) > 1 else ():
        yield replace(scales, alpha=_without(scales.alpha, alpha)), f"without alpha {alpha:g}"


def _without(values: tuple[float, ...], omitted: float) -> tuple[float, ...]:
    return tuple(value for value in values if value != omitted)

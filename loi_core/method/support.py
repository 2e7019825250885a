"""Supports: the pixels and levels where two images can differ at one inner scale, so that only these are computed.

* Where the blurred image equals the blurred reference, the isophotes are equal. The difference of the two stacks of
  CDFs is 0 outside a window; its blurs, and the cotangent that is pulled back, are 0 outside a larger window.
* Levels far enough below or above all intensities are ties (:func:`loi_core.method.distance.tie_threshold`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from loi_core.method.gaussian import truncation
from loi_core.method.plan import InnerPlan
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window, window_of
from loi_core.support.arrays import Array, namespace

__all__ = [
    "Dependency",
    "LevelRange",
    "Supports",
    "active_levels",
    "dependency_of",
    "differing_window",
    "find_dependency",
]

MAX_CROPPED_FRACTION: Final = 0.75
"""Fraction of the samples above which a window saves less than cropping costs."""


@dataclass(frozen=True)
class Supports:
    """Windows outside which a difference of CDFs and everything computed from it is 0.

    Attributes
    ----------
    differences : tuple of Window
        Supports of the difference, on every pyramid level; level 0 is the sampling of the inner scale.
    cotangents : tuple of Window
        Supports of the cotangents there.
    """

    differences: tuple[Window, ...]
    cotangents: tuple[Window, ...]

    def image_window(self, *, gradient: bool) -> Window:
        """Return the pixels that the comparison, or its gradient, depends on."""
        return self.cotangents[0] if gradient else self.differences[0]

    @classmethod
    def of(cls, differing: Window, plan: InnerPlan) -> Supports:
        """Return the supports of a difference that is 0 outside a window."""
        differences = [differing]
        for step in plan.pyramid:
            differences.append(step.support_of(differences[-1]))
        cotangents: dict[int, Window] = {}

        def add(level: int, window: Window) -> None:
            cotangents[level] = cotangents[level] | window if level in cotangents else window

        for extent in plan.extents:
            add(extent.start, extent.blur.adjoint_support_of(extent.blur.support_of(differences[extent.start])))
        for level in range(len(plan.pyramid), 0, -1):
            add(level - 1, plan.pyramid[level - 1].adjoint_support_of(cotangents[level]))
        return cls(tuple(differences), tuple(cotangents[level] for level in range(len(differences))))


@dataclass(frozen=True)
class Dependency:
    """The pixels and intensities that a comparison depends on.

    Attributes
    ----------
    supports : Supports
    window : Window
        Pixels whose intensity changes the distance or, without gradient, pixels that differ.
    lowest : float
        Smallest intensity of the image in the window.
    low, high : float
        Smallest and largest intensity of both images where they differ.
    """

    supports: Supports
    window: Window
    lowest: float = -math.inf
    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def everything(cls, plan: InnerPlan) -> Dependency:
        """Return the dependency on all pixels and intensities."""
        whole = Window.whole(plan.grid.rows.cells, plan.grid.columns.cells)
        return cls(Supports.of(whole, plan), whole)


def find_dependency(
    intensity: Array, reference: Array, plan: InnerPlan, scales: ScaleSpace, *, gradient: bool
) -> Dependency | None:
    """Return the dependency of a comparison of planes, shape (N, h, w); None if they are equal. Reads values."""
    differing = differing_window(intensity, reference, scales)
    if differing is None:
        return None
    return dependency_of(Supports.of(differing, plan), intensity, reference, scales, gradient=gradient)


def differing_window(intensity: Array, reference: Array, scales: ScaleSpace) -> Window | None:
    """Return the smallest window outside which the difference of CDFs of planes, shape (N, h, w), is 0.

    It is the whole plane if cropping saves little or the difference is centred, and None if the planes are equal.
    """
    differing = window_of(intensity != reference)
    if differing is None:
        return None
    whole = Window.whole(*intensity.shape[-2:])
    return whole if scales.centred or differing.cells > MAX_CROPPED_FRACTION * whole.cells else differing


def dependency_of(
    supports: Supports, intensity: Array, reference: Array, scales: ScaleSpace, *, gradient: bool
) -> Dependency:
    """Return the dependency of a comparison of planes that differ in the first support."""
    differing = supports.differences[0]
    window = supports.image_window(gradient=gradient)
    if scales.p != 1.0:
        return Dependency(supports, window)  # a small power of a tie is not small
    xp = namespace(intensity)
    image, expected = differing.crop(intensity), differing.crop(reference)
    low, high = float(xp.min(image)), float(xp.max(image))
    lowest = low if window == differing else min(low, float(xp.min(window.crop(intensity))))
    low, high = min(low, float(xp.min(expected))), max(high, float(xp.max(expected)))
    return Dependency(supports, window, min(low, lowest), low, high)


@dataclass(frozen=True)
class LevelRange:
    """A range of tonal levels: the first to accumulate, the first to compare, and the end."""

    start: int
    first: int
    stop: int


def active_levels(
    levels: Sequence[float], compared: int, dependency: Dependency, scales: ScaleSpace, beta: float, eps: float
) -> LevelRange:
    """Return the range of `levels` that a dependency makes active.

    Below all intensities a CDF holds tails only. Above, it holds the total, which is the same for every intensity up to
    the ripple of a sum of samples about an integral, 2 exp(-2 (pi beta / spacing)**2): 5e-9 for levels beta apart.

    Parameters
    ----------
    levels : sequence of float
        Increasing intensities.
    compared : int
        Index of the first level that the plan compares.
    dependency : Dependency
    scales : ScaleSpace
    beta : float
    eps : float
        Machine epsilon.
    """
    below = truncation(eps) * beta
    ripple = 2.0 * math.exp(-2.0 * (math.pi * beta / scales.spacing(beta)) ** 2)
    above = below if ripple <= eps else math.inf
    start = sum(level < dependency.lowest - below for level in levels)
    first = max(start, compared, sum(level < dependency.low - below for level in levels))
    return LevelRange(start, first, sum(level <= dependency.high + above for level in levels))

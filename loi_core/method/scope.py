"""What of two images can differ at one inner scale, so that only that is computed.

* Where the blurred image equals that of the reference, so do the isophotes. The difference of the two stacks of CDFs
  is 0 outside a window, its blurs are 0 outside a somewhat larger one, and so is what is pulled back.
* Levels far enough below or above all intensities are ties (:func:`loi_core.method.distance.tie_threshold`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from loi_core.method.gaussian import reach
from loi_core.method.plan import InnerPlan
from loi_core.method.scales import ScaleSpace
from loi_core.method.windows import Window, window_of
from loi_core.support.arrays import Array, namespace

__all__ = ["Among", "Route", "Scope", "differing_window", "find_scope", "levels_among", "scope_of"]

WORTHWHILE: Final = 0.75
"""Share of the samples above which a window saves less than cutting it out costs."""


@dataclass(frozen=True)
class Route:
    """Outside which windows a difference of CDFs and all that is made of it is 0.

    Attributes
    ----------
    support : tuple of Window
        Of the difference: on the sampling of the inner scale, and on every level of its pyramid.
    pulled : tuple of Window
        Of what is pulled back there.
    """

    support: tuple[Window, ...]
    pulled: tuple[Window, ...]

    @classmethod
    def of(cls, start: Window, plan: InnerPlan) -> Route:
        """The route of a difference that is 0 outside `start`."""
        support = [start]
        for step in plan.pyramid:
            support.append(step.reached(support[-1]))
        pulled: dict[int, Window] = {}

        def add(index: int, window: Window) -> None:
            pulled[index] = pulled[index] | window if index in pulled else window

        for extent in plan.extents:
            add(extent.start, extent.blur.reached_back(extent.blur.reached(support[extent.start])))
        for index in range(len(plan.pyramid), 0, -1):
            add(index - 1, plan.pyramid[index - 1].reached_back(pulled[index]))
        return cls(tuple(support), tuple(pulled[index] for index in range(len(support))))


@dataclass(frozen=True)
class Scope:
    """What of some planes has to be looked at.

    Attributes
    ----------
    route : Route
    support : Window
        Where intensities move the distance, or, if no gradient is wanted, where they differ.
    least : float
        The least of the image's intensities there.
    low, high : float
        The least and largest intensity of both images where they differ.
    """

    route: Route
    support: Window
    least: float = -math.inf
    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def everything(cls, plan: InnerPlan) -> Scope:
        """All of the planes."""
        whole = Window.whole(plan.grid.rows.cells, plan.grid.columns.cells)
        return cls(Route.of(whole, plan), whole)


def find_scope(
    intensity: Array, reference: Array, plan: InnerPlan, scales: ScaleSpace, *, gradient: bool
) -> Scope | None:
    """What of some planes, shape (N, h, w), has to be looked at; None if nothing does. Looks at their values."""
    differing = differing_window(intensity, reference)
    if differing is None:
        return None
    return scope_of(differing, Route.of(differing, plan), intensity, reference, scales, gradient=gradient)


def differing_window(intensity: Array, reference: Array) -> Window | None:
    """The smallest window outside which planes, shape (N, h, w), are equal; all of them if that saves little."""
    differing = window_of(intensity != reference)
    if differing is None:
        return None
    whole = Window.whole(*intensity.shape[-2:])
    return whole if differing.cells > WORTHWHILE * whole.cells else differing


def scope_of(
    differing: Window, route: Route, intensity: Array, reference: Array, scales: ScaleSpace, *, gradient: bool
) -> Scope:
    """What of some planes has to be looked at if they differ in a window, from which there is a route."""
    support = route.pulled[0] if gradient else differing
    if scales.p != 1.0:
        return Scope(route, support)  # a small power of what counts as a tie is not small
    xp = namespace(intensity)
    seen, wanted = differing.crop(intensity), differing.crop(reference)
    low, high = float(xp.min(seen)), float(xp.max(seen))
    least = low if support == differing else min(low, float(xp.min(support.crop(intensity))))
    low, high = min(low, float(xp.min(wanted))), max(high, float(xp.max(wanted)))
    return Scope(route, support, min(low, least), low, high)


@dataclass(frozen=True)
class Among:
    """Which of some levels matter: the first to accumulate, the first to compare, and where to stop."""

    start: int
    first: int
    stop: int


def levels_among(
    levels: Sequence[float], compared: int, scope: Scope, scales: ScaleSpace, beta: float, eps: float
) -> Among:
    """Which of `levels`, increasing intensities that are compared from the number `compared` on, are in a scope.

    Below all intensities a CDF holds tails only. Above, it holds all of the total, which is the same for every
    intensity up to the ripple of a sum of samples about an integral, 2 exp(-2 (pi beta / spacing)**2): 5e-9 for levels
    beta apart.
    """
    below = reach(eps) * beta
    ripple = 2.0 * math.exp(-2.0 * (math.pi * beta / scales.spacing(beta)) ** 2)
    above = below if ripple <= eps else math.inf
    start = sum(level < scope.least - below for level in levels)
    first = max(start, compared, sum(level < scope.low - below for level in levels))
    return Among(start, first, sum(level <= scope.high + above for level in levels))

"""What came of a fit, in one line, and what to try where it is not what one wanted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.fitting.parameters import Bounds
from loi_core.fitting.state import FitStep
from loi_core.fitting.verdict import Diagnosis, Verdict
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, to_numpy

__all__ = ["Findings", "diagnose"]

FOUND: Final = 0.02, 1.5
"""What a fit that has found its target leaves at the most: of the loss at the start, and of what noise makes of it."""

LOUD: Final = 0.7
"""Of the loss at the start: with more noise than that, there is little else to follow."""

FALLING: Final = 0.1
"""A loss that falls by more than this fraction over the last quarter of the steps still falls."""

FADED: Final = 1e-6
"""Of the largest gradient on the way: less is none."""


@dataclass(frozen=True)
class Findings:
    """What a fit has seen, for :func:`diagnose`.

    Attributes
    ----------
    start, end : float
        The last objective at the start and at the best parameters; there of the mean of some renders, where these
        are random.
    noise : float
        The same objective between one of these renders and their mean; 0 where nothing is random.
    history : sequence of FitStep
    params : dict of arrays
        The best.
    bounds : Bounds
    visible : dict of bool
        Of each free parameter, whether a change of it changed the image.
    image, reference : array, shape (H, W, C), optional
        The start's render and the target.
    """

    start: float
    end: float
    noise: float
    history: tuple[FitStep, ...]
    params: Parameters
    bounds: Bounds
    visible: Mapping[str, bool]
    image: Host | None = None
    reference: Host | None = None


def diagnose(seen: Findings) -> Diagnosis:
    """The verdict on a fit."""
    left, noise = (each / seen.start if seen.start > 0.0 else 0.0 for each in (seen.end, seen.noise))
    norms = [one.gradient_norm for one in seen.history]
    rest = f"{left:.0%} of the loss at the start is left"

    def say(verdict: Verdict, message: str, advice: str = "") -> Diagnosis:
        return Diagnosis(verdict, message, advice, left, noise)

    if seen.start == 0.0:
        return say("converged", "the start is the target, as far as the loss sees")
    if max(norms, default=0.0) == 0.0:
        hidden = [name for name, one in seen.visible.items() if not one]
        if hidden:
            return say("no gradient", f"{_listed(hidden)} leave no trace in the image", "check that they are in view")
        return say(
            "no gradient",
            "start and target differ, but the gradient is 0 throughout",
            "the renderer has none for these parameters, or wider scales are needed",
        )
    if left <= FOUND[0] + FOUND[1] * noise:
        return say("converged", rest)
    if noise > LOUD * (1.0 + left):
        return say("follows noise", f"{rest}, and noise makes {noise:.0%} of it", "raise the samples")
    encoded = _encoding(seen.image, seen.reference)
    if encoded:
        return say("other range", f"{rest}; {encoded}", "compare linear radiance with linear radiance")
    if norms[-1] <= FADED * max(norms):
        return say("left the frame", f"{rest}, and the gradient is gone", "start nearer, or set bounds")
    held = _at_bounds(seen.params, seen.bounds)
    if held:
        return say("at a bound", f"{rest}, and {_listed(held)} ended at a bound", "widen it, or start elsewhere")
    last = [one.value for one in seen.history if one.stage == seen.history[-1].stage]
    quarter = last[-max(len(last) // 4, 2) :]
    if len(quarter) >= 4:
        half = len(quarter) // 2
        first, second = float(np.mean(quarter[:half])), float(np.mean(quarter[half:]))
        if first - second > FALLING * abs(second):
            return say("still falling", rest, "give it more steps")
    return say(
        "stalled",
        f"{rest} and no longer falls",
        "if the renderer can make the target exactly, try starts=8, or start nearer",
    )


def _listed(names: list[str]) -> str:
    return " and ".join(map(repr, names))


def _at_bounds(params: Parameters, bounds: Bounds) -> list[str]:
    """The parameters that have an entry at a bound, where the bound leaves room."""
    found = []
    for name, lower in bounds.lower.items():
        value, low, high = (np.asarray(to_numpy(one)) for one in (params[name], lower, bounds.upper[name]))
        if np.any(((value == low) | (value == high)) & (low < high)):
            found.append(name)
    return found


def _encoding(image: Host | None, reference: Host | None) -> str:
    """What is wrong if one of two images looks as if it were encoded for a display and the other not; or empty."""
    if image is None or reference is None or image.shape != reference.shape:
        return ""
    levels = np.linspace(0.02, 0.98, 49)
    ours, theirs = (np.quantile(np.nan_to_num(each), levels) for each in (image, reference))
    apart = float(np.mean(np.abs(ours - theirs)))
    for first, second, says in (
        (ours, theirs, "the target looks encoded for a display (sRGB), the render linear"),
        (theirs, ours, "the render looks encoded for a display (sRGB), the target linear"),
    ):
        if apart > 0.05 and float(np.mean(np.abs(first - _linear(second)))) < 0.35 * apart:
            return says
    return ""


def _linear(encoded: Host) -> Host:
    """Linear radiance of values encoded by sRGB (IEC 61966-2-1)."""
    inside = np.clip(encoded, 0.0, 1.0)
    return np.where(inside <= 0.04045, inside / 12.92, ((inside + 0.055) / 1.055) ** 2.4)

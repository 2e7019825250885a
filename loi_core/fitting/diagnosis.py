"""What came of a fit, in one line, and what to try where it is not what one wanted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.parameters import Bounds
from loi_core.fitting.race import moving, unbounded
from loi_core.fitting.state import FitResult
from loi_core.fitting.verdict import Diagnosis, Verdict
from loi_core.fitting.views import Images, View, Views, as_given, by_view, mean
from loi_core.objectives import ImageObjective, LOIObjective, Objective
from loi_core.pixels.encoding import encode_srgb
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import measure_units
from loi_core.support.arrays import Host, detached, from_numpy, to_numpy
from loi_core.support.wording import clause, listed

__all__ = ["Findings", "diagnose", "judged", "nearness"]

FOUND: Final = 0.02, 1.5
"""What a fit that has found its target leaves at the most: of the loss at the start, and of what noise makes of it."""

RENDERS: Final = 8
"""Whose mean tells what is left from what is noise."""

LOUD: Final = 0.7
"""Of the loss at the start: with more noise than that, there is little else to follow."""

FALLING: Final = 0.1
"""A loss that falls by more than this fraction over the last quarter of the steps still falls."""

APART: Final = 0.05
"""How far the values of two images have to be apart before one of them may be encoded."""

ALIKE: Final = 0.35
"""Of how far their values are apart: the most that may be left of it once one is encoded."""

MOSTLY: Final = 0.6
"""Likewise of how far their pixels are apart, which what is not in its place keeps apart."""

FADED: Final = 1e-6
"""Of the largest gradient on the way: less is none."""

STEADY: Final = 0.9
"""Of the steps of the last stage: where a loss falls in so many, it was not yet there."""

SHORT: Final = 16
"""Steps of a stage: of fewer one can say little more than whether the loss has fallen."""

SEEN: Final = 40.0
"""dB: images that are further apart differ to the eye."""

MANY: Final = 64
"""Numbers: those of a texture or of a mesh, whose last digits are for pixels to find."""

FINISH: Final = 'for so many numbers, finish="pixels" comes nearer, if the renderer can make the target exactly'


@dataclass(frozen=True)
class Findings:
    """What a fit has seen, for :func:`diagnose`.

    Attributes
    ----------
    start, end : float
        The objective at the start and at the best parameters; there of the mean of some renders, where these are
        random.
    noise : float
        The same objective between one of these renders and their mean; 0 where nothing is random.
    history : sequence of FitStep
    params : dict of arrays
        The best.
    bounds : Bounds
    visible : dict of bool
        Of each free parameter, whether a change of it changed the image.
    unmoved : sequence of str
        Free parameters that have their starting values still.
    pairs : list of (array, array)
        The start's render and the target, shape (H, W, C), of each view.
    finish : bool
        Whether the fit had a finish on pixels.
    psnr : float, optional
        Of the start's render, where pixels count; dB.
    """

    start: float
    end: float
    noise: float
    history: Sequence[FitStep]
    params: Parameters
    bounds: Bounds
    visible: Mapping[str, bool]
    unmoved: Sequence[str] = ()
    pairs: Sequence[tuple[Host, Host]] = ()
    finish: bool = False
    psnr: float | None = None


def judged(views: Views, start: Parameters, bounds: Bounds, result: FitResult, seed: int) -> Diagnosis | None:
    """What came of a fit from a start; None if a renderer or an objective refuses to say."""
    try:
        views, placing, finish = views.unabridged(), views.placing, views.finish
        images = views.render(start, seed)
        first = mean(views.values(images, placing))
        ends, noises = {}, {}
        for name, view in views.each.items():
            objective, at = view.objectives[placing], seed + result.best_step
            ends[name], noises[name] = _end_and_noise(view, objective, result.best_params, at)
        visible: dict[str, bool] = {}
        if all(one.gradient_norm == 0.0 for one in result.history):
            units, _ = measure_units(list(views.each.values()), start, bounds, bounds.lower, seed=seed)
            visible = {name: math.isfinite(unit) for name, unit in units.items()}
        pairs = [
            (to_numpy(images[name]), to_numpy(view.objectives[-1].reference))
            for name, view in views.each.items()
            if isinstance(view.objectives[-1], ImageObjective)
        ]
    except Exception:  # noqa: BLE001 - the fit is done, whatever a renderer does beyond it
        return None
    found, near = result.best_params, nearness(views, as_given(images))
    unmoved = _unmoved(start, found, bounds)
    return diagnose(
        Findings(first, mean(ends), mean(noises), result.history, found, bounds, visible, unmoved, pairs, finish, near)
    )


def _unmoved(start: Parameters, found: Parameters, bounds: Bounds) -> list[str]:
    """The free parameters that no step has moved; none if nothing has moved, since the start may be the best."""
    still = []
    for name, lower in bounds.lower.items():
        before, after, low, high = (to_numpy(one) for one in (start[name], found[name], lower, bounds.upper[name]))
        if np.array_equal(before, after) and np.all((low < before) & (before < high)):
            still.append(name)
    return still if len(still) < len(bounds.lower) else []


def nearness(views: Views, images: Images) -> float | None:
    """PSNR of images against the references of the last objectives, where pixels count, in dB; None if not known."""
    errors = []
    for name, image in by_view(images).items():
        objective = views.each[name].objectives[-1]
        if not isinstance(objective, ImageObjective):
            return None
        pixels, reference = (to_numpy(one) for one in (image, objective.reference))
        if pixels.shape != reference.shape:
            return None
        axis = objective.channel_axis
        pixels, reference = (
            one[..., None] if axis is None else np.moveaxis(one, axis, -1) for one in (pixels, reference)
        )
        errors.append(10.0 ** (-0.1 * psnr(pixels, reference, objective.weights)))
    error = sum(errors) / len(errors)
    if math.isnan(error):  # where pixels that are not finite are passed over
        return None
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def _end_and_noise(view: View, objective: Objective, params: Parameters, seed: int) -> tuple[float, float]:
    """The value of an objective for the mean of some renders, and what it says of one beside that mean."""
    image, noise = view.render(params, seed=seed), 0.0
    again = [view.render(params, seed=seed + 1)]
    if not np.array_equal(to_numpy(again[0]), to_numpy(image)):
        again += [view.render(params, seed=seed + k) for k in range(2, RENDERS + 1)]
        average = np.mean([np.asarray(to_numpy(one), dtype=np.float64) for one in again], axis=0)
        if isinstance(objective, LOIObjective):
            noise = float(detached(objective.with_reference(average).value(to_numpy(image))))
        image = from_numpy(average, image)
    return float(detached(objective.value(image))), noise


def diagnose(seen: Findings) -> Diagnosis:
    """The verdict on a fit."""
    left, noise = (each / seen.start if seen.start > 0.0 else 0.0 for each in (seen.end, seen.noise))
    norms = [one.gradient_norm for one in seen.history]
    rest = f"{left:.0%} of the loss at the start is left"
    if seen.unmoved:
        rest += f", {clause(seen.unmoved, 'had no gradient and has', 'had no gradient and have')} not moved"

    def say(verdict: Verdict, message: str, advice: str = "") -> Diagnosis:
        return Diagnosis(verdict, message, advice, left, noise)

    blind = max(norms, default=0.0) == 0.0
    hidden = [name for name, one in seen.visible.items() if not one]
    if blind and hidden:
        return say(
            "no gradient",
            clause(hidden, "leaves no trace in the image", "leave no trace in the image"),
            "check that they are in view",
        )
    if seen.start == 0.0 and seen.psnr is not None and seen.psnr < SEEN:
        return say(
            "no gradient",
            f"start and target differ ({seen.psnr:.1f} dB), and the loss does not see it",
            "it may compare too little: look at its scales and their bounds, and at `colours`",
        )
    if seen.start == 0.0:
        return say("converged", "the start is the target, as far as the loss sees")
    if blind:
        return say(
            "no gradient",
            "start and target differ, but the gradient is 0 throughout",
            "what moves may be hidden, or out of reach of all scales, or the renderer may have no gradient by it; "
            "give bounds and `starts`, or start elsewhere",
        )
    if left <= FOUND[0] + FOUND[1] * noise:
        return say("converged", rest, FINISH if moving(seen.bounds) > MANY and not seen.finish else "")
    if noise > LOUD * (1.0 + left):
        return say("follows noise", f"{rest}, and noise makes {noise:.0%} of it", "raise the samples")
    ranges = [found for image, reference in seen.pairs if (found := _other_range(image, reference))]
    if ranges:
        return say("other range", f"{rest}; {ranges[0][0]}", ranges[0][1])
    if norms[-1] <= FADED * max(norms):
        bounds = "set bounds" if unbounded(seen.bounds) else "narrow the bounds to what is in view"
        return say("left the frame", f"{rest}, and the gradient is gone", f"start nearer, or {bounds}")
    held = _at_bounds(seen.params, seen.bounds)
    if held:
        return say("at a bound", f"{rest}, and {listed(held)} ended at a bound", "widen it, or start elsewhere")
    last = [one.value for one in seen.history if one.stage == seen.history[-1].stage]
    if _falls(last):
        return say("still falling", rest, _with_finish("give it more steps", seen))
    if np.mean(np.diff(last) < 0.0) >= STEADY:
        more = _with_finish("give it more steps, or a higher learning_rate", seen)
        return say("still falling", f"{rest}, and it fell in nearly every step", more)
    return say("stalled", f"{rest} and no longer falls", _for_one_that_stalls(seen))


def _falls(values: Sequence[float]) -> bool:
    """Whether the values of the last stage still fall at its end; of few values, whether they fell at all."""
    if len(values) < SHORT:
        return len(values) < 2 or values[-1] < values[0]
    quarter = values[-(len(values) // 4) :]
    half = len(quarter) // 2
    first, second = float(np.mean(quarter[:half])), float(np.mean(quarter[half:]))
    return first - second > FALLING * abs(second)


def _with_finish(advice: str, seen: Findings) -> str:
    return f"{advice}; {FINISH}" if moving(seen.bounds) > MANY and not seen.finish else advice


def _for_one_that_stalls(seen: Findings) -> str:
    """What to try where a loss no longer falls, and it may be that the renderer can make the target exactly."""
    if moving(seen.bounds) > MANY and not seen.finish:
        return f"{FINISH}; if things are out of place as well, free fewer numbers first"
    endless = unbounded(seen.bounds)
    if endless:
        return f"give {listed(endless)} bounds: within them the fit searches, and starts=8 can begin elsewhere"
    return "if the renderer can make the target exactly, try more steps, starts=8, or a nearer start"


def _at_bounds(params: Parameters, bounds: Bounds) -> list[str]:
    """The parameters that have an entry at a bound, where the bound leaves room."""
    found = []
    for name, lower in bounds.lower.items():
        value, low, high = (np.asarray(to_numpy(one)) for one in (params[name], lower, bounds.upper[name]))
        if np.any(((value == low) | (value == high)) & (low < high)):
            found.append(name)
    return found


def _other_range(image: Host, reference: Host) -> tuple[str, str] | None:
    """What is wrong if one of two images looks as if it were encoded for a display and the other not, and what to do.

    The distribution of values has to say so, and most pixels as well: noise shifts the one, but not along the curve.
    Where one exposure explains as much, it is that.
    """
    if image.shape != reference.shape:
        return None
    levels = np.linspace(0.02, 0.98, 49)
    ours, theirs = (np.clip(np.nan_to_num(each), 0.0, 1.0) for each in (image, reference))
    for linear, encoded, says in (
        (ours, theirs, "the target looks encoded for a display (sRGB), the render linear"),
        (theirs, ours, "the render looks encoded for a display (sRGB), the target linear"),
    ):
        # Encoded, since decoding makes all small numbers smaller, whatever they are.
        seen, wanted = encode_srgb(linear), encoded
        pixels = float(np.mean(np.abs(seen - wanted))), float(np.mean(np.abs(linear - wanted)))
        low, high, goal = (np.quantile(each, levels) for each in (linear, seen, wanted))
        values = float(np.mean(np.abs(high - goal))), float(np.mean(np.abs(low - goal)))
        if values[1] > APART and values[0] < ALIKE * values[1] and pixels[0] < MOSTLY * pixels[1]:
            exposure = float(np.sum(ours * theirs) / np.sum(ours * ours))
            if np.mean(np.abs(exposure * ours - theirs)) < pixels[0]:
                return f"the target is {exposure:.2g} times as bright as the render", "match the exposure, or fit it"
            return says, "compare linear with linear: read_target(file, to='linear')"
    return None

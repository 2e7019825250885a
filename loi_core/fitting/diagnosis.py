"""The diagnosis of a fit: a verdict in one line, and advice if the target was not found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.fitting.history import FitStep
from loi_core.fitting.misfit import Misfit, measure_misfit
from loi_core.fitting.parameters import Bounds, free_numbers
from loi_core.fitting.starts import unbounded_parameters
from loi_core.fitting.state import FitResult
from loi_core.fitting.verdict import Diagnosis, Verdict
from loi_core.fitting.views import Images, View, Views, by_view, mean, ungrouped
from loi_core.objectives import ImageObjective, LOIObjective
from loi_core.pixels.encoding import encode_srgb
from loi_core.pixels.exposure import LinearExposure
from loi_core.pixels.psnr import psnr
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import measure_units
from loi_core.support.arrays import Array, Host, detached, from_numpy, to_numpy
from loi_core.support.wording import clause, listed

__all__ = ["FitEvidence", "diagnose", "diagnose_fit", "exposures_of", "psnr_of"]

CONVERGED_FRACTION: Final = 0.02
"""Fraction of the initial loss that a converged fit leaves at most, beside the noise."""

CONVERGED_NOISE: Final = 1.5
"""Multiple of the noise that a converged fit may leave in addition."""

NOISE_RENDERS: Final = 8
"""Number of renders whose mean separates the remaining loss from noise."""

MAX_NOISE: Final = 0.7
"""Fraction of the initial loss: with more noise, the gradient follows noise."""

MIN_FALL: Final = 0.1
"""Relative decrease over the last quarter of the steps at which a loss still falls."""

STEADY_FRACTION: Final = 0.9
"""Fraction of the last stage's steps: a loss that decreases in as many has not converged."""

MIN_STEPS: Final = 16
"""Number of values below which only the first and the last are compared."""

FADED_GRADIENT: Final = 1e-6
"""Fraction of the largest gradient norm below which the gradient is gone."""

MIN_RANGE_DIFFERENCE: Final = 0.05
"""Mean difference of the quantiles of two images above which one of them may be encoded."""

MAX_QUANTILE_RATIO: Final = 0.35
"""Fraction of that difference that may remain once one image is encoded."""

MAX_PIXEL_RATIO: Final = 0.6
"""The same for pixels, which a wrong position keeps different."""

VISIBLE_DB: Final = 40.0
"""PSNR below which images look different."""

MAX_UNEXPLAINED: Final = 0.3
"""Share of the contrast of moving pixels that a photograph may have beside its render: noise, blur, a hand in view."""

MAX_MOTION_PX: Final = 0.5
"""Further motion of a parameter, which pixels ask for, at which it counts as found."""

MIN_OFFSET: Final = 0.005  # units of intensity, below which a message leaves it out

MANY_NUMBERS: Final = 64
"""Number of free numbers, such as those of a texture or a mesh, from which on pixels find the last digits."""

POLISH_ADVICE: Final = 'for so many numbers, polish="pixels" comes nearer, if the renderer can make the target exactly'


@dataclass(frozen=True)
class FitEvidence:
    """The observations of a fit that :func:`diagnose` judges.

    Attributes
    ----------
    start_value, end_value : float
        The objective at the start and at the best parameters, there of the mean of several renders if they are random.
    noise : float
        The objective between one of these renders and their mean; 0 if nothing is random.
    history : sequence of FitStep
    params : dict of arrays
        The best parameters.
    bounds : Bounds
    visible : dict of bool
        Whether a change of each free parameter changes the image.
    unmoved : sequence of str
        Free parameters that still have their starting values.
    pairs : list of (array, array)
        The render at the start and the target, shape (H, W, C), of each view.
    polish : bool
        Whether the last stage compared pixels.
    psnr : float, optional
        Of the render at the start, in dB.
    exposed : tuple of float, optional
        The objective at the start and at the end once the exposure of the target is regressed; None where the objective
        does so itself, or cannot.
    exposures : sequence of LinearExposure
        The exposure of the target relative to the last render of each view, with gain and offset of shape (C,).
    misfit : Misfit, optional
        Of the best parameters, in the pixels that they move.
    """

    start_value: float
    end_value: float
    noise: float
    history: Sequence[FitStep]
    params: Parameters
    bounds: Bounds
    visible: Mapping[str, bool]
    unmoved: Sequence[str] = ()
    pairs: Sequence[tuple[Host, Host]] = ()
    polish: bool = False
    psnr: float | None = None
    exposed: tuple[float, float] | None = None
    exposures: Sequence[LinearExposure] = ()
    misfit: Misfit | None = None


def diagnose_fit(views: Views, start: Parameters, bounds: Bounds, result: FitResult, seed: int) -> Diagnosis | None:
    """Return the diagnosis of a fit from its start; None if a renderer or an objective fails meanwhile."""
    try:
        views = views.unabridged()
        images = views.render(start, seed)
        start_value = mean(
            {name: float(detached(view.requested.value(images[name]))) for name, view in views.by_name.items()}
        )
        end_values, noises, last_images = {}, {}, {}
        for name, view in views.by_name.items():
            end_seed = seed + result.best_step
            last_images[name], noises[name] = _image_and_noise(view, result.best_params, end_seed)
            end_values[name] = float(detached(view.requested.value(last_images[name])))
        visible: dict[str, bool] = {}
        if all(step.gradient_norm == 0.0 for step in result.history):
            units, _ = measure_units(list(views.by_name.values()), start, bounds, bounds.lower, seed=seed)
            visible = {name: math.isfinite(unit) for name, unit in units.items()}
        has_converged = mean(end_values) <= CONVERGED_FRACTION * start_value
        exposed = None if has_converged else _values_under_exposure(views, images, last_images)
        pairs = [
            (to_numpy(images[name]), to_numpy(view.objectives[-1].reference))
            for name, view in views.by_name.items()
            if isinstance(view.objectives[-1], ImageObjective)
        ]
        misfit = measure_misfit(views, result.best_params, bounds, seed + result.best_step)
    except Exception:  # noqa: BLE001 - the fit is done, whatever a renderer does afterwards
        return None
    return diagnose(
        FitEvidence(
            start_value,
            mean(end_values),
            mean(noises),
            result.history,
            result.best_params,
            bounds,
            visible,
            _unmoved(start, result.best_params, bounds),
            pairs,
            views.polishes,
            psnr_of(views, ungrouped(images)),
            exposed,
            () if result.exposure is None else tuple(by_view(result.exposure).values()),
            misfit,
        )
    )


def _unmoved(start: Parameters, best: Parameters, bounds: Bounds) -> list[str]:
    """Return the free parameters that no step has moved; none if all are unmoved, since the start may be the best."""
    unmoved = []
    for name, lower in bounds.lower.items():
        initial, final, lowest, highest = (
            to_numpy(value) for value in (start[name], best[name], lower, bounds.upper[name])
        )
        if np.array_equal(initial, final) and np.all((lowest < initial) & (initial < highest)):
            unmoved.append(name)
    return unmoved if len(unmoved) < len(bounds.lower) else []


def psnr_of(views: Views, images: Images) -> float | None:
    """Return the PSNR of images against the references of the last objectives in dB, over counted pixels; or None."""
    errors = []
    for name, image in by_view(images).items():
        objective = views.by_name[name].objectives[-1]
        if not isinstance(objective, ImageObjective):
            return None
        pixels, reference = (to_numpy(array) for array in (image, objective.reference))
        if pixels.shape != reference.shape:
            return None
        axis = objective.channel_axis
        pixels, reference = (
            array[..., None] if axis is None else np.moveaxis(array, axis, -1) for array in (pixels, reference)
        )
        errors.append(10.0 ** (-0.1 * psnr(pixels, reference, objective.weights)))
    error = sum(errors) / len(errors)
    if math.isnan(error):  # pixels that are not finite are masked
        return None
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def exposures_of(views: Views, images: Images) -> dict[str, LinearExposure]:
    """Return the exposure of each view's reference relative to its image, with gain and offset of shape (C,)."""
    exposures = {}
    for name, image in by_view(images).items():
        objective = views.by_name[name].requested
        if not isinstance(objective, ImageObjective) or tuple(image.shape) != tuple(objective.reference.shape):
            continue
        exposure = objective.exposure_of(detached(image))
        exposures[name] = LinearExposure(to_numpy(exposure.gain).reshape(-1), to_numpy(exposure.offset).reshape(-1))
    return exposures


def _values_under_exposure(
    views: Views, first: Mapping[str, Images], last: Mapping[str, Images]
) -> tuple[float, float] | None:
    """Return the objective of the first and last images once the exposure is regressed."""
    values = {}
    for name, view in views.by_name.items():
        objective = view.requested
        if not isinstance(objective, LOIObjective) or objective.exposure != "given":
            return None
        regressed = objective.with_exposure("regressed")
        values[name] = tuple(float(detached(regressed.value(images[name]))) for images in (first, last))
    start, end = (mean({name: pair[index] for name, pair in values.items()}) for index in (0, 1))
    return start, end


def _image_and_noise(view: View, params: Parameters, seed: int) -> tuple[Array, float]:
    """Return the mean of several renders, and the objective between one render and that mean."""
    image, noise = view.render(params, seed=seed), 0.0
    renders = [view.render(params, seed=seed + 1)]
    if not np.array_equal(to_numpy(renders[0]), to_numpy(image)):
        renders += [view.render(params, seed=seed + k) for k in range(2, NOISE_RENDERS + 1)]
        average = np.mean([np.asarray(to_numpy(render), dtype=np.float64) for render in renders], axis=0)
        if isinstance(view.requested, LOIObjective):
            noise = float(detached(view.requested.with_reference(average).value(to_numpy(image))))
        image = from_numpy(average, image)
    return image, noise


def diagnose(evidence: FitEvidence) -> Diagnosis:
    """Return the verdict on a fit."""
    left, noise = (
        value / evidence.start_value if evidence.start_value > 0.0 else 0.0
        for value in (evidence.end_value, evidence.noise)
    )
    norms = [step.gradient_norm for step in evidence.history]
    summary = f"{left:.0%} of the loss at the start is left"
    inert = () if evidence.misfit is None else evidence.misfit.inert
    if inert:
        summary += f", {clause(inert, 'leaves no trace in the image', 'leave no trace in the image')}"
    unmoved = [name for name in evidence.unmoved if name not in inert]
    if unmoved:
        summary += f", {clause(unmoved, 'had no gradient and has', 'had no gradient and have')} not moved"

    def verdict(name: Verdict, message: str, advice: str = "") -> Diagnosis:
        return Diagnosis(name, message, advice, left, noise)

    no_gradient = max(norms, default=0.0) == 0.0
    hidden = [name for name, is_visible in evidence.visible.items() if not is_visible]
    if no_gradient and hidden:
        message = clause(hidden, "leaves no trace in the image", "leave no trace in the image")
        return verdict("no gradient", message, "check that they are in view")
    if evidence.start_value == 0.0 and evidence.psnr is not None and evidence.psnr < VISIBLE_DB:
        return verdict(
            "no gradient",
            f"start and target differ ({evidence.psnr:.1f} dB), and the loss does not see it",
            "it may compare too little: look at its scales and their bounds, and at `colours`",
        )
    if evidence.start_value == 0.0:
        return verdict("converged", "the start is the target, as far as the loss sees")
    if no_gradient:
        return verdict(
            "no gradient",
            "start and target differ, but the gradient is 0 throughout",
            "the moving objects may be hidden, or out of reach of all scales, or the renderer may not differentiate "
            "with respect to these parameters; give bounds and `starts`, or start elsewhere",
        )
    if left <= CONVERGED_FRACTION + CONVERGED_NOISE * noise:
        return verdict("converged", summary, POLISH_ADVICE if _wants_polish(evidence) else "")
    if evidence.exposed is not None and evidence.exposures and evidence.exposed[0] > 0.0:
        exposed_left, exposed_noise = (value / evidence.exposed[0] for value in (evidence.exposed[1], evidence.noise))
        if exposed_left <= CONVERGED_FRACTION + CONVERGED_NOISE * exposed_noise:
            message = (
                f"{exposed_left:.0%} of the loss at the start is left, but for the exposure: {_described(evidence)}"
            )
            return verdict("converged", message)
    if noise > MAX_NOISE * (1.0 + left):
        return verdict("follows noise", f"{summary}, and noise makes {noise:.0%} of it", "raise the samples")
    ranges = [mismatch for pair in evidence.pairs if (mismatch := _range_mismatch(*pair))]
    if ranges:
        return verdict("other range", f"{summary}; {ranges[0][0]}", ranges[0][1])
    misfit = evidence.misfit
    if misfit is not None and misfit.unexplained <= MAX_UNEXPLAINED and misfit.motion <= MAX_MOTION_PX:
        explained = f"the render explains {1.0 - misfit.unexplained:.0%} of the contrast in the pixels that move"
        return verdict("converged", f"{summary}, but {explained}")
    if norms[-1] <= FADED_GRADIENT * max(norms):
        bounds = "set bounds" if unbounded_parameters(evidence.bounds) else "narrow the bounds to the field of view"
        return verdict("left the frame", f"{summary}, and the gradient is gone", f"start nearer, or {bounds}")
    at_bound = _at_bounds(evidence.params, evidence.bounds)
    if at_bound:
        message = f"{summary}, and {listed(at_bound)} ended at a bound"
        elsewhere = "start elsewhere" if unbounded_parameters(evidence.bounds) else "let starts=8 begin elsewhere"
        return verdict("at a bound", message, f"widen it, or {elsewhere}")
    last = [step.value for step in evidence.history if step.stage == evidence.history[-1].stage]
    if _falls(last):
        return verdict("still falling", summary, _or_polish("give it more steps", evidence))
    if np.mean(np.diff(last) < 0.0) >= STEADY_FRACTION:
        advice = _or_polish("give it more steps, or a higher learning_rate", evidence)
        return verdict("still falling", f"{summary}, and it fell in nearly every step", advice)
    return verdict("stalled", f"{summary} and no longer falls", _advice_if_stalled(evidence))


def _described(evidence: FitEvidence) -> str:
    """Describe the exposure of the target, the mean over channels and views."""
    gain, offset = (
        float(np.mean([np.mean(part) for part in parts]))
        for parts in zip(*((entry.gain, entry.offset) for entry in evidence.exposures), strict=True)
    )
    added = f" {'-' if offset < 0.0 else '+'} {abs(offset):.2f}" if abs(offset) >= MIN_OFFSET else ""
    return f"the target is about {gain:.2f} times the render{added}"


def _falls(values: Sequence[float]) -> bool:
    """Return whether the values of the last stage still fall at its end; whether they fell at all if they are few."""
    if len(values) < MIN_STEPS:
        return len(values) < 2 or values[-1] < values[0]
    quarter = values[-(len(values) // 4) :]
    half = len(quarter) // 2
    first, second = float(np.mean(quarter[:half])), float(np.mean(quarter[half:]))
    return first - second > MIN_FALL * abs(second)


def _wants_polish(evidence: FitEvidence) -> bool:
    return free_numbers(evidence.bounds) > MANY_NUMBERS and not evidence.polish


def _or_polish(advice: str, evidence: FitEvidence) -> str:
    return f"{advice}; {POLISH_ADVICE}" if _wants_polish(evidence) else advice


def _advice_if_stalled(evidence: FitEvidence) -> str:
    if _wants_polish(evidence):
        return f"{POLISH_ADVICE}; if objects are out of place as well, free fewer numbers first"
    unbounded = unbounded_parameters(evidence.bounds)
    if unbounded:
        return f"give {listed(unbounded)} bounds: within them the fit searches, and starts=8 can begin elsewhere"
    return "if the renderer can make the target exactly, try more steps, starts=8, or a nearer start"


def _at_bounds(params: Parameters, bounds: Bounds) -> list[str]:
    """Return the parameters with an entry at a bound, unless both bounds are equal."""
    names = []
    for name, lower in bounds.lower.items():
        value, lowest, highest = (np.asarray(to_numpy(array)) for array in (params[name], lower, bounds.upper[name]))
        if np.any(((value == lowest) | (value == highest)) & (lowest < highest)):
            names.append(name)
    return names


def _range_mismatch(image: Host, reference: Host) -> tuple[str, str] | None:
    """Return a message and advice if one of two images looks encoded for a display and the other does not.

    Both the distribution of values and most pixels must agree, since noise shifts the distribution but not along the
    encoding curve. If one exposure explains as much, it is the exposure.
    """
    if image.shape != reference.shape:
        return None
    levels = np.linspace(0.02, 0.98, 49)
    render, target = (np.clip(np.nan_to_num(array), 0.0, 1.0) for array in (image, reference))
    for linear, other_image, message in (
        (render, target, "the target looks encoded for a display (sRGB), the render linear"),
        (target, render, "the render looks encoded for a display (sRGB), the target linear"),
    ):
        # Encoding, since decoding makes all small numbers smaller, whatever they are.
        encoded = encode_srgb(linear)
        pixels = float(np.mean(np.abs(encoded - other_image))), float(np.mean(np.abs(linear - other_image)))
        linear_levels, encoded_levels, goal = (np.quantile(array, levels) for array in (linear, encoded, other_image))
        values = float(np.mean(np.abs(encoded_levels - goal))), float(np.mean(np.abs(linear_levels - goal)))
        if (
            values[1] > MIN_RANGE_DIFFERENCE
            and values[0] < MAX_QUANTILE_RATIO * values[1]
            and pixels[0] < MAX_PIXEL_RATIO * pixels[1]
        ):
            exposure = float(np.sum(render * target) / np.sum(render * render))
            if np.mean(np.abs(exposure * render - target)) < pixels[0]:
                return (
                    f"the target is {exposure:.2g} times as bright as the render",
                    'exposure="matched", or fit the exposure',
                )
            return message, "compare linear with linear: read_target(file, to='linear')"
    return None

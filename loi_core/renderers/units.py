"""Measurement of units: the change of each parameter that moves the image by one pixel.

Learning rates in pixels then apply to metres, angles, scales and exposures alike. A parameter that changes intensities
without motion counts as the motion that would change the image as much; or, where the image is still flat, such as a
grey texture, as the motion that would change the target as much.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from loi_core.method.blurs import gaussian_blur
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host, from_numpy, to_numpy
from loi_core.support.guards import wrap_errors

__all__ = ["first_step", "measure_units", "pixels_of"]

BLUR_PX: Final = 2.0  # turns edges into slopes, so that the change is linear in a motion of about a pixel
MAX_RENDERS: Final = 10  # per parameter
LINEAR_RANGE_PX: Final = (0.4, 2.5)  # motions with a sufficiently linear change
FIRST_STEP: Final = 1e-2  # fraction of the range between the bounds, or of the magnitude of the values, or of 1
GROWTH: Final = 8.0  # largest factor between steps
MIN_CHANGE: Final = 0.1  # fraction of the largest change below which a pixel is ignored
NOISE_FACTOR: Final = 3.0  # changes within this multiple of the noise between seeds are insignificant
FLAT_IMAGE: Final = 0.1  # fraction of the target's squared slope below which an image of equal brightness is flat


class RendersImages(Protocol):
    """A renderer, or one view of a fit."""

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the image, shape (H, W, C)."""


class Limits(Protocol):
    """Bounds by parameter, as arrays like the parameters."""

    @property
    def lower(self) -> Mapping[str, Array]:
        """Lower bounds."""

    @property
    def upper(self) -> Mapping[str, Array]:
        """Upper bounds."""


def pixels_of(value: object) -> float:
    """Return the number in a text such as "1.5 px"; NaN for anything else."""
    match = re.fullmatch(r"\s*([0-9.eE+-]{1,32})\s*px\s*", value) if isinstance(value, str) else None
    try:
        return float(match[1]) if match else math.nan
    except ValueError:
        return math.nan


def first_step(value: Host, lower: Host, upper: Host) -> float:
    """Return a small change of an array: a fraction of its widest finite range, else of its magnitude, at least 1."""
    span = upper - lower
    finite = span[np.isfinite(span)]
    scale = float(finite.max()) if finite.size else max(1.0, float(np.abs(value).max(initial=0.0)))
    return FIRST_STEP * (scale or 1.0)


def measure_units(
    renderers: Sequence[RendersImages],
    params: Parameters,
    bounds: Limits | None,
    names: Iterable[str],
    *,
    targets: Sequence[Array | None] = (),
    seed: int = 0,
) -> tuple[dict[str, float], int]:
    """Measure the change of each parameter that moves the image by one pixel.

    Parameters
    ----------
    renderers : sequence of Renderer
        One per view; each renders up to ten times per parameter. The view with the largest motion counts.
    params : dict of arrays
        Linearisation point.
    bounds : Bounds or None
        Bounds that no rendered parameters exceed; None for unbounded parameters.
    names : iterable of str
        Names of the parameters to measure.
    targets : sequence of array or None
        Target of each view, shape (H, W, C), if known.
    seed : int
        Seed of all renders but one, which measures the noise.

    Returns
    -------
    units : dict of float
        In the unit of the parameter; for an array, the change of each entry if all of them change. Infinite if no value
        within the bounds changes the image. If neither the image, nor the target, nor the changed image has a slope,
        the range between the bounds counts as the side of the image.
    side : int
        Longest side of an image, in pixels.
    """
    padded_targets = [*targets, *[None] * (len(renderers) - len(targets))]
    views = [
        _View.of(renderer, params, target, seed) for renderer, target in zip(renderers, padded_targets, strict=True)
    ]
    units = {name: _unit(views, params, bounds, name, seed) for name in names}
    return units, max(view.side for view in views)


@dataclass(frozen=True)
class _View:
    """A view before any motion: its image, the squared slopes of image and target, and its noise."""

    renderer: RendersImages
    image: Host
    slope: Host
    target_slope: Host
    noise: float

    @classmethod
    def of(cls, renderer: RendersImages, params: Parameters, target: Array | None, seed: int) -> _View:
        image, reseeded = (_render(renderer, params, image_seed) for image_seed in (seed, seed + 1))
        noise = float(np.sqrt(np.mean((reseeded - image) ** 2)))
        return cls(renderer, image, _squared_slope(image), _target_slope(image, target), noise)

    def motion(self, params: Parameters, name: str, seed: int) -> float:
        """Return the motion of the image through `name`, in pixels; 0 within the noise, infinite without any slope."""
        moved = _render(self.renderer, params, seed, f"with {name!r} moved, to measure its unit,")
        change = moved - self.image
        magnitude = np.abs(change)
        largest = float(magnitude.max(initial=0.0))
        if largest <= NOISE_FACTOR * self.noise or largest == 0.0 or not math.isfinite(largest):
            return 0.0
        changed = magnitude > max(MIN_CHANGE * largest, self.noise)
        energy = float(np.sum(change[changed] ** 2))
        slope, target_slope = (float(np.sum(slopes[changed])) for slopes in (self.slope, self.target_slope))
        slope = target_slope if slope < FLAT_IMAGE * target_slope else slope
        if energy > self.side**2 * slope:  # a motion larger than the image: the change itself has brought the slopes
            slope = float(np.sum(_squared_slope(moved)[changed]))
        return math.inf if energy > self.side**2 * slope else math.sqrt(energy / slope)

    @property
    def side(self) -> int:
        """The longer side of the image, in pixels."""
        height, width = self.image.shape[-2:]
        return max(int(height), int(width))


def _unit(views: Sequence[_View], params: Parameters, bounds: Limits | None, name: str, seed: int) -> float:
    value = np.asarray(to_numpy(params[name]), dtype=np.float64)
    lower, upper = np.full(value.shape, -math.inf), np.full(value.shape, math.inf)
    if bounds is not None:
        lower, upper = (np.asarray(to_numpy(limit[name]), dtype=np.float64) for limit in (bounds.lower, bounds.upper))
    # Each entry moves in a random direction, or towards the farther bound.
    is_bounded = np.isfinite(np.maximum(upper - value, value - lower))
    sign = np.where(np.random.default_rng(0).random(value.shape) < 0.5, -1.0, 1.0)
    sign = np.where((sign > 0) & (upper - value < value - lower) & is_bounded, -1.0, sign)
    sign = np.where((sign < 0) & (value - lower < upper - value) & is_bounded, 1.0, sign)
    step = first_step(value, lower, upper)
    scale = step / FIRST_STEP
    unit, min_error = math.inf, math.inf
    for _ in range(MAX_RENDERS):
        moved = np.clip(value + step * sign, lower, upper)
        change = float(np.abs(moved - value).max(initial=0.0))
        if change == 0.0:
            break
        moved_params = params | {name: from_numpy(moved, params[name])}
        motions = [view.motion(moved_params, name, seed) for view in views]
        pixels = max((motion for motion in motions if math.isfinite(motion)), default=0.0)
        if pixels == 0.0 and math.inf in motions:
            return scale / max(view.side for view in views)
        error = abs(math.log(pixels)) if pixels > 0.0 else math.inf
        if error < min_error:
            unit, min_error = change / pixels, error
        if LINEAR_RANGE_PX[0] <= pixels <= LINEAR_RANGE_PX[1] or (change < 0.5 * step and pixels < 1.0):
            break
        step = change * min(max(1.0 / pixels if pixels > 0.0 else GROWTH, 1.0 / GROWTH**2), GROWTH)
    return unit


def _render(renderer: RendersImages, params: Parameters, seed: int, purpose: str = "to measure units") -> Host:
    with wrap_errors(f"rendering {purpose}"):
        return _blurred(renderer.render(params, seed=seed))


def _blurred(image: Array) -> Host:
    """Return the blurred planes of an image, shape (C, H, W)."""
    planes = np.moveaxis(np.asarray(to_numpy(image), dtype=np.float64), -1, 0)
    height, width = planes.shape[-2:]
    blurred: Host = gaussian_blur(height, width, BLUR_PX, "reflect", like=planes).apply(np.ascontiguousarray(planes))
    return blurred


def _squared_slope(image: Host) -> Host:
    """Return the squared spatial gradient of planes at every pixel."""
    with np.errstate(all="ignore"):  # an overflow is an infinite slope
        by_y, by_x = (np.gradient(image, axis=axis) if image.shape[axis] > 1 else image * 0.0 for axis in (1, 2))
        squared: Host = by_y**2 + by_x**2
    return squared


@np.errstate(all="ignore")  # the result of an overflow is not finite, which is checked
def _target_slope(image: Host, target: Array | None) -> Host:
    """Return the squared slope of a target, dimmed to the brightness of the image; 0 without a target.

    The slope is at least the difference between image and target over the side of the image, since a smooth target may
    be far away too.
    """
    if target is None or tuple(target.shape) != (*image.shape[1:], image.shape[0]):
        return np.zeros_like(image)
    pixels = np.asarray(to_numpy(target), dtype=np.float64)
    finite = np.isfinite(pixels)
    planes = _blurred(np.where(finite, pixels, np.mean(pixels, where=finite) if finite.any() else 0.0))
    brightness, target_brightness = (float(np.mean(np.abs(values))) for values in (image, planes))
    if not math.isfinite(target_brightness):
        return np.zeros_like(image)
    factor = min(brightness / target_brightness, 1.0) if target_brightness > 0.0 else 0.0
    min_slope = (factor * planes - image) / max(image.shape[-2:])
    slope: Host = np.maximum(factor**2 * _squared_slope(planes), min_slope**2)
    return slope

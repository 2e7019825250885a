"""How far each parameter has to change for the image to move by a pixel, measured from the renderer.

A rate in pixels then serves metres, angles, scales and exposures alike. What changes intensities without moving
anything counts as the movement that would change the image as much; or, where the image is flat yet, as a grey texture
is, as the movement that would change the target as much.
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

__all__ = ["measure_units", "pixels_of"]

BLUR: Final = 2.0  # pixels: edges become slopes over which a movement of a pixel is a linear change
MOST: Final = 10  # renders for a parameter
NEAR: Final = (0.4, 2.5)  # pixels within which the change is linear enough
FIRST: Final = 1e-2  # of the range between the bounds, or of the size of the values, or of 1
GROWTH: Final = 8.0
CHANGED: Final = 0.1  # of the largest change: less is not looked at
NOISE: Final = 3.0  # times what other seeds change
FLAT: Final = 0.1  # of the squared slope of a target as bright: an image with less has to get its slopes yet


class Renders(Protocol):
    """A renderer, or one view of a fit."""

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """The image, shape (H, W, C)."""


class Limits(Protocol):
    """Bounds by parameter, as arrays like the parameters."""

    @property
    def lower(self) -> Mapping[str, Array]:
        """The least values."""

    @property
    def upper(self) -> Mapping[str, Array]:
        """The greatest."""


def pixels_of(value: object) -> float:
    """The number in a text such as "1.5 px"; NaN for anything else."""
    match = re.fullmatch(r"\s*([0-9.eE+-]{1,32})\s*px\s*", value) if isinstance(value, str) else None
    try:
        return float(match[1]) if match else math.nan
    except ValueError:
        return math.nan


def measure_units(
    renderers: Sequence[Renders],
    params: Parameters,
    bounds: Limits | None,
    names: Iterable[str],
    *,
    targets: Sequence[Array | None] = (),
    seed: int = 0,
) -> tuple[dict[str, float], int]:
    """By how much a parameter changes when the image moves by a pixel.

    Parameters
    ----------
    renderers : sequence of Renderer
        One for each view; they render up to ten times for each parameter. The view that moves most counts.
    params : dict of arrays
        Where to measure.
    bounds : Bounds or None
        Nothing outside of them is rendered; None for none.
    names : iterable of str
        The parameters to measure.
    targets : sequence of array or None
        What each view is to show, shape (H, W, C), as far as it is known: nothing, by default.
    seed : int
        Of all renders but one, which tells what noise changes.

    Returns
    -------
    units : dict of float
        In the parameter's own unit, for an array that of each entry if all of them change. Infinite where nothing that
        is within the bounds changes the image. Where neither the image, nor the target, nor what the image turns into
        has a slope, the range between the bounds counts as the side of the image.
    side : int
        The longest side of an image, in pixels.
    """
    known = [*targets, *[None] * (len(renderers) - len(targets))]
    seen = [_Seen.of(renderer, params, target, seed) for renderer, target in zip(renderers, known, strict=True)]
    units = {name: _unit(seen, params, bounds, name, seed) for name in names}
    return units, max(one.side for one in seen)


@dataclass(frozen=True)
class _Seen:
    """A view before anything has moved: its image, the squared slopes of that and of its target, and its noise."""

    renderer: Renders
    image: Host
    slope: Host
    wanted: Host
    noise: float

    @classmethod
    def of(cls, renderer: Renders, params: Parameters, target: Array | None, seed: int) -> _Seen:
        image, other = (_render(renderer, params, each) for each in (seed, seed + 1))
        noise = float(np.sqrt(np.mean((other - image) ** 2)))
        return cls(renderer, image, _squared_slope(image), _wanted(image, target), noise)

    def movement(self, params: Parameters, name: str, seed: int) -> float:
        """How far the image has moved by `name`, in pixels; 0 if noise explains it, infinite if nothing has a slope."""
        after = _render(self.renderer, params, seed, f"with {name!r} moved, to measure its unit,")
        change = after - self.image
        size = np.abs(change)
        largest = float(size.max(initial=0.0))
        if largest <= NOISE * self.noise or largest == 0.0 or not math.isfinite(largest):
            return 0.0
        seen = size > max(CHANGED * largest, self.noise)
        energy = float(np.sum(change[seen] ** 2))
        steep, wanted = (float(np.sum(slope[seen])) for slope in (self.slope, self.wanted))
        steep = wanted if steep < FLAT * wanted else steep
        if energy > self.side**2 * steep:  # farther than anything can move: the slopes come with the change
            steep = float(np.sum(_squared_slope(after)[seen]))
        return math.inf if energy > self.side**2 * steep else math.sqrt(energy / steep)

    @property
    def side(self) -> int:
        """The longer side of the image, in pixels."""
        height, width = self.image.shape[-2:]
        return max(int(height), int(width))


def _unit(seen: Sequence[_Seen], params: Parameters, bounds: Limits | None, name: str, seed: int) -> float:
    at = np.asarray(to_numpy(params[name]), dtype=np.float64)
    low, high = np.full(at.shape, -math.inf), np.full(at.shape, math.inf)
    if bounds is not None:
        low, high = (np.asarray(to_numpy(side[name]), dtype=np.float64) for side in (bounds.lower, bounds.upper))
    room = np.maximum(high - at, at - low)
    sign = np.where(np.random.default_rng(0).random(at.shape) < 0.5, -1.0, 1.0)
    sign = np.where((sign > 0) & (high - at < at - low) & np.isfinite(room), -1.0, sign)
    sign = np.where((sign < 0) & (at - low < high - at) & np.isfinite(room), 1.0, sign)
    span = high - low
    finite = span[np.isfinite(span)]
    size = float(finite.max()) if finite.size else max(1.0, float(np.abs(at).max(initial=0.0)))
    step = FIRST * size if size > 0.0 else FIRST
    best, error = math.inf, math.inf
    for _ in range(MOST):
        moved = np.clip(at + step * sign, low, high)
        change = float(np.abs(moved - at).max(initial=0.0))
        if change == 0.0:
            break
        there = params | {name: from_numpy(moved, params[name])}
        moved_by = [one.movement(there, name, seed) for one in seen]
        pixels = max((each for each in moved_by if math.isfinite(each)), default=0.0)
        if pixels == 0.0 and math.inf in moved_by:
            return size / max(one.side for one in seen)
        off = abs(math.log(pixels)) if pixels > 0.0 else math.inf
        if off < error:
            best, error = change / pixels, off
        if NEAR[0] <= pixels <= NEAR[1] or (change < 0.5 * step and pixels < 1.0):
            break
        step = change * min(max(1.0 / pixels if pixels > 0.0 else GROWTH, 1.0 / GROWTH**2), GROWTH)
    return best


def _render(renderer: Renders, params: Parameters, seed: int, why: str = "to measure units") -> Host:
    with wrap_errors(f"rendering {why}"):
        return _blurred(renderer.render(params, seed=seed))


def _blurred(image: Array) -> Host:
    """Planes of an image, shape (C, H, W), blurred."""
    planes = np.moveaxis(np.asarray(to_numpy(image), dtype=np.float64), -1, 0)
    height, width = planes.shape[-2:]
    blurred: Host = gaussian_blur(height, width, BLUR, "reflect", like=planes).apply(np.ascontiguousarray(planes))
    return blurred


def _squared_slope(image: Host) -> Host:
    """The squared gradient of planes by position, per pixel."""
    with np.errstate(all="ignore"):  # what overflows is infinitely steep
        down, across = (np.gradient(image, axis=axis) if image.shape[axis] > 1 else image * 0.0 for axis in (1, 2))
        squares: Host = down**2 + across**2
    return squares


@np.errstate(all="ignore")  # what overflows is not finite, and looked for
def _wanted(image: Host, target: Array | None) -> Host:
    """The squared slope of a target that is no brighter than the image; 0 where it is not known.

    At least as steep as it takes to become the target along the side of the image: a smooth one may be far as well.
    """
    if target is None or tuple(target.shape) != (*image.shape[1:], image.shape[0]):
        return np.zeros_like(image)
    pixels = np.asarray(to_numpy(target), dtype=np.float64)
    known = np.isfinite(pixels)
    planes = _blurred(np.where(known, pixels, np.mean(pixels, where=known) if known.any() else 0.0))
    ours, theirs = (float(np.mean(np.abs(each))) for each in (image, planes))
    if not math.isfinite(theirs):
        return np.zeros_like(image)
    dimmed = min(ours / theirs, 1.0) if theirs > 0.0 else 0.0
    way = (dimmed * planes - image) / max(image.shape[-2:])
    wanted: Host = np.maximum(dimmed**2 * _squared_slope(planes), way**2)
    return wanted

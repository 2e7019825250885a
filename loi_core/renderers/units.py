"""How far each parameter has to change for the image to move by a pixel, measured from the renderer.

A rate in pixels then serves metres, angles, scales and exposures alike. What changes intensities without moving
anything counts as the movement that would change the image as much.
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
from loi_core.support.guards import foreign

__all__ = ["measure_units", "pixels_of"]

BLUR: Final = 2.0  # pixels: edges become slopes over which a movement of a pixel is a linear change
MOST: Final = 10  # renders for a parameter
NEAR: Final = (0.4, 2.5)  # pixels within which the change is linear enough
FIRST: Final = 1e-2  # of the range between the bounds, or of the size of the values, or of 1
GROWTH: Final = 8.0
CHANGED: Final = 0.1  # of the largest change: less is not looked at
NOISE: Final = 3.0  # times what other seeds change


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
    renderers: Sequence[Renders], params: Parameters, bounds: Limits | None, names: Iterable[str], *, seed: int = 0
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
    seed : int
        Of all renders but one, which tells what noise changes.

    Returns
    -------
    units : dict of float
        In the parameter's own unit, for an array that of each entry if all of them change. Infinite where nothing that
        is within the bounds changes the image.
    side : int
        The longest side of an image, in pixels.
    """
    seen = [_Seen.of(renderer, params, seed) for renderer in renderers]
    units = {name: _unit(seen, params, bounds, name, seed) for name in names}
    return units, max(max(one.image.shape[-2:]) for one in seen)


@dataclass(frozen=True)
class _Seen:
    """A view before anything has moved: its image, the squared slope there, and its noise."""

    renderer: Renders
    image: Host
    slope: Host
    noise: float

    @classmethod
    def of(cls, renderer: Renders, params: Parameters, seed: int) -> _Seen:
        image, other = (_render(renderer, params, each) for each in (seed, seed + 1))
        return cls(renderer, image, _squared_slope(image), float(np.sqrt(np.mean((other - image) ** 2))))

    def movement(self, params: Parameters, seed: int) -> float:
        """How far the image has moved, in pixels."""
        return _movement(_render(self.renderer, params, seed) - self.image, self.slope, self.noise)


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
        pixels = max(one.movement(there, seed) for one in seen)
        off = abs(math.log(pixels)) if pixels > 0.0 else math.inf
        if off < error:
            best, error = change / pixels, off
        if NEAR[0] <= pixels <= NEAR[1] or (change < 0.5 * step and pixels < 1.0):
            break
        step = change * min(max(1.0 / pixels if pixels > 0.0 else GROWTH, 1.0 / GROWTH**2), GROWTH)
    return best


def _render(renderer: Renders, params: Parameters, seed: int) -> Host:
    with foreign("rendering to measure a unit"):
        planes = np.moveaxis(np.asarray(to_numpy(renderer.render(params, seed=seed)), dtype=np.float64), -1, 0)
    height, width = planes.shape[-2:]
    blurred: Host = gaussian_blur(height, width, BLUR, "reflect", like=planes).apply(np.ascontiguousarray(planes))
    return blurred


def _squared_slope(image: Host) -> Host:
    """The squared gradient of planes by position, per pixel."""
    down, across = (np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image) for axis in (1, 2))
    squares: Host = down**2 + across**2
    return squares


def _movement(change: Host, slope: Host, noise: float) -> float:
    """How far a movement is that changes the image so, in pixels; 0 if noise explains the change."""
    size = np.abs(change)
    largest = float(size.max(initial=0.0))
    if largest <= NOISE * noise or largest == 0.0 or not math.isfinite(largest):
        return 0.0
    seen = size > max(CHANGED * largest, noise)
    steep = float(np.sum(slope[seen]))
    return math.sqrt(float(np.sum(change[seen] ** 2)) / max(steep, 1e-30))

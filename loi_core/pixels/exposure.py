"""The exposure of a reference relative to an image: a gain and an offset for each channel, estimated from both.

A camera's exposure, white balance and veiling glare change a photograph by about ``gain * image + offset`` in each
channel. An image is given the exposure of the reference before the two are compared, and the estimate is held in the
gradient: the exposure is no part of the scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, get_args

from loi_core.errors import OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.wording import shown

__all__ = ["Exposure", "LinearExposure", "check_exposure", "estimate_exposure"]

Exposure = Literal["given", "matched", "regressed", "detected"]

GAIN_RANGE: Final = (0.25, 4.0)  # two stops either way; a render that is nearly constant would need any gain
SMALL_DEVIATION: Final = 1e-6  # added to both deviations, in units of intensity: two constant images have the gain 1
REGRESSION_SIGMA: Final = 1.5  # pixels: edges that are not quite aligned would lower the gain
REGRESSION_STRIDE: Final = 2  # pixels: the blurred images hold no finer detail
REGRESSION_STEPS: Final = 12  # of reweighted least squares
MIN_RESIDUAL: Final = 1e-4  # units of intensity: bounds the weight of a pixel in the regression
MIN_DIFFERENCE: Final = 0.5 / 255.0  # units of intensity: half a step of an 8-bit image is no other exposure


@dataclass(frozen=True)
class LinearExposure:
    """An affine map of intensities, for each plane of an image.

    Attributes
    ----------
    gain, offset : array, shape (N, 1, 1)
    """

    gain: Array
    offset: Array

    def apply(self, planes: Array) -> Array:
        """Return ``gain * planes + offset``, shape (N, H, W)."""
        return planes * self.gain + self.offset

    def pullback(self, cotangent: Array) -> Array:
        """Return the cotangent of the argument of :meth:`apply`, with gain and offset held."""
        return cotangent * self.gain


def check_exposure(exposure: object) -> Exposure:
    """Return `exposure` if it is allowed.

    Raises
    ------
    OptionError
    """
    for name in get_args(Exposure):
        if isinstance(exposure, str) and exposure == name:
            checked: Exposure = name
            return checked
    msg = f"`exposure` must be one of {', '.join(map(repr, get_args(Exposure)))}, got {shown(exposure)}"
    raise OptionError(msg)


def estimate_exposure(image: Array, reference: Array, weights: Array | None, exposure: Exposure) -> LinearExposure:
    """Return the exposure that brings planes of an image, shape (N, H, W), closest to planes of a reference.

    Parameters
    ----------
    image, reference : array, shape (N, H, W)
        Finite.
    weights : array, shape (N, H, W), optional
        Weights of pixels; None if all count alike.
    exposure : {"matched", "regressed", "detected"}
        "matched" gives the image the mean and deviation of the reference, which needs no alignment. "regressed"
        minimises the sum of absolute differences over aligned pixels, blurred by 1.5 pixels. "detected" is the same,
        and leaves a plane whose intensities in [0, 1] it would change by less than half a step of 8 bits. The gain is
        limited to [1/4, 4].
    """
    xp = namespace(image)
    ones = xp.ones_like(image) if weights is None else weights
    if exposure == "matched":
        return _matched(image, reference, ones)
    if weights is None:
        image, reference = _blurred(image), _blurred(reference)
        ones = xp.ones_like(image)
    else:  # pixels of weight 0, which may hold anything, must not reach their neighbours
        seen = xp.astype(weights > 0.0, image.dtype)
        mass = xp.clip(_blurred(seen), min=SMALL_DEVIATION)
        image, reference = _blurred(image * seen) / mass, _blurred(reference * seen) / mass
        ones = weights[..., ::REGRESSION_STRIDE, ::REGRESSION_STRIDE]
    fitted = _least_squares(image, reference, ones)
    for _ in range(REGRESSION_STEPS):
        residual = xp.abs(fitted.apply(image) - reference)
        pixel_weights = ones / xp.clip(residual, min=MIN_RESIDUAL)
        fitted = _least_squares(image, reference, pixel_weights)
    return _where_different(fitted) if exposure == "detected" else fitted


def _where_different(fitted: LinearExposure) -> LinearExposure:
    """Return an exposure that is the identity in planes where it would change no intensity in [0, 1] visibly."""
    xp = namespace(fitted.gain)
    change = xp.maximum(xp.abs(fitted.offset), xp.abs(fitted.gain - 1.0 + fitted.offset))
    different = change > MIN_DIFFERENCE
    gain = xp.where(different, fitted.gain, xp.ones_like(fitted.gain))
    return LinearExposure(gain, xp.where(different, fitted.offset, xp.zeros_like(fitted.offset)))


def _matched(image: Array, reference: Array, weights: Array) -> LinearExposure:
    (mean, variance), (target_mean, target_variance) = _moments(image, weights), _moments(reference, weights)
    xp = namespace(image)
    ratio = (xp.sqrt(target_variance) + SMALL_DEVIATION) / (xp.sqrt(variance) + SMALL_DEVIATION)
    gain = xp.clip(ratio, *GAIN_RANGE)
    return LinearExposure(gain, target_mean - gain * mean)


def _least_squares(image: Array, reference: Array, weights: Array) -> LinearExposure:
    mean, variance = _moments(image, weights)
    target_mean = _mean(reference, weights)
    covariance = _mean((image - mean) * (reference - target_mean), weights)
    floor = SMALL_DEVIATION**2
    gain = namespace(image).clip((covariance + floor) / (variance + floor), *GAIN_RANGE)
    return LinearExposure(gain, target_mean - gain * mean)


def _moments(planes: Array, weights: Array) -> tuple[Array, Array]:
    """Return the weighted mean and variance of each plane, shape (N, 1, 1) both."""
    mean = _mean(planes, weights)
    return mean, _mean((planes - mean) ** 2, weights)


def _mean(planes: Array, weights: Array) -> Array:
    """Return the weighted mean of each plane, shape (N, 1, 1); 0 where all weights are 0."""
    xp = namespace(planes)
    total = xp.sum(weights, axis=(-2, -1), keepdims=True)
    total = xp.where(total > 0.0, total, xp.ones_like(total))
    return xp.sum(planes * weights, axis=(-2, -1), keepdims=True) / total


def _blurred(planes: Array) -> Array:
    """Return every other row and column of planes blurred by a Gaussian of 1.5 pixels; border pixels repeat outside."""
    xp = namespace(planes)
    radius = math.ceil(3.0 * REGRESSION_SIGMA)
    kernel = [math.exp(-0.5 * (offset / REGRESSION_SIGMA) ** 2) for offset in range(-radius, radius + 1)]
    for _ in range(2):
        size = planes.shape[-1]
        padded = xp.concat([planes[..., :1]] * radius + [planes] + [planes[..., -1:]] * radius, axis=-1)
        windows = (padded[..., start : start + size : REGRESSION_STRIDE] for start in range(len(kernel)))
        blurred = sum(weight * window for weight, window in zip(kernel, windows, strict=True))
        planes = xp.matrix_transpose(blurred / sum(kernel))
    return planes

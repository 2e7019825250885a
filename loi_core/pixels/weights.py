"""Weights of pixels, and masks, which are weights of 0 and 1: of a reference, and of the image of one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core.errors import ImageError, ImageTypeError, OptionError
from loi_core.pixels.layout import Layout
from loi_core.support.arrays import (
    Array,
    Host,
    device,
    from_numpy,
    held,
    is_array_api_obj,
    is_numpy_array,
    is_traced,
    library_name,
    namespace,
    to_numpy,
    widened,
)
from loi_core.support.wording import shown

__all__ = ["CallWeights", "PixelWeights", "check_call_weights", "require_mask", "weight_planes"]


@dataclass(frozen=True)
class PixelWeights:
    """Weights of the pixels of an image.

    Attributes
    ----------
    normalised : array, shape (*batch, H, W), float64
        The weights in units of the largest, in [0, 1].
    largest : float
        The largest weight.
    """

    normalised: Host
    largest: float

    @classmethod
    def of(cls, weights: Any, layout: Layout) -> PixelWeights:
        """Return checked weights, shape (*batch, H, W), for a reference of this layout.

        Raises
        ------
        ImageTypeError
            If they are not an array of numbers.
        ImageError
            If the shape does not fit, a weight is negative or not finite, or all are 0.
        """
        _require_real(weights)
        values = np.asarray(to_numpy(weights)).astype(np.float64)
        _require_shape(values.shape, layout, "reference")
        _require_valid(values)
        largest = float(values.max())
        if largest == 0.0:
            msg = "`weights` must not all be 0: nothing would be compared"
            raise ImageError(msg)
        return cls(values / largest, largest)

    @property
    def is_mask(self) -> bool:
        """Whether all positive weights are equal."""
        return _is_mask(self.normalised)

    @property
    def has_zeros(self) -> bool:
        """Whether any weight is 0."""
        return bool(np.any(self.normalised == 0.0))

    @property
    def values(self) -> Host:
        """The weights as passed, shape (*batch, H, W), float64."""
        return self.normalised * self.largest

    def planes(self, layout: Layout, like: Array) -> Array:
        """Return the normalised weights as planes of shape (N, H, W) for images of `layout`, an array like `like`.

        Raises
        ------
        ImageError
            If the batch axes do not fit the images' batch axes.
        """
        weights = self.normalised if layout.channel_axis is None else self.normalised[..., None, :, :]
        try:
            stack = np.broadcast_to(weights, layout.planes_shape)
        except ValueError:
            msg = f"`weights` have shape {self.normalised.shape}, which does not fit images of shape {layout.shape}"
            raise ImageError(msg) from None
        return from_numpy(np.ascontiguousarray(stack).reshape(-1, layout.height, layout.width), like)


@dataclass(frozen=True, eq=False)
class CallWeights:
    """Weights of the pixels of one image, in the image's library, which may lack values while JAX traces.

    Attributes
    ----------
    planes : array, shape (N, H, W)
        The weights in units of the largest, in [0, 1]; 0 if all are 0.
    largest : array, shape ()
        The largest weight.
    """

    planes: Array
    largest: Array

    @classmethod
    def of(cls, weights: Array, layout: Layout, like: Array, *, has_values: bool = True) -> CallWeights:
        """Return checked weights, shape (*batch, H, W), for images of `layout` that are arrays like `like`.

        Gradients take them as constants. Errors as in :meth:`PixelWeights.of`, but all may be 0. Values that JAX
        traces are not checked, and no values without `has_values`.
        """
        check_call_weights(weights, layout)
        weights = held(weights)
        if not is_traced(weights) and (library_name(weights) != library_name(like) or device(weights) != device(like)):
            weights = to_numpy(weights)
        xp = namespace(weights)
        if not xp.isdtype(weights.dtype, "real floating"):
            weights = xp.astype(weights, xp.float32)
        weights = widened(weights)
        if has_values and not is_traced(weights):
            _require_valid(weights)
        largest = xp.max(weights)
        # Divided before rounding to the image's dtype, which may round small weights to 0.
        normalised = weights / xp.where(largest > 0.0, largest, xp.ones_like(largest))
        normalised, largest = (_like(array, like) for array in (normalised, largest))
        return cls(weight_planes(normalised, layout), largest)

    @property
    def is_mask(self) -> bool:
        """Whether all positive weights are equal; True while JAX traces, as values cannot be read."""
        return is_traced(self.planes) or _is_mask(self.planes)


def require_mask(objective: str, weights: PixelWeights | CallWeights) -> None:
    """Raise :class:`OptionError` unless `weights` are a mask, for an objective that multiplies nothing by weights."""
    if not weights.is_mask:
        msg = f"`weights` of {objective} must be a mask: 0 and one positive value, no other weights"
        raise OptionError(msg)


def check_call_weights(weights: Any, layout: Layout) -> None:
    """Raise an error unless `weights` are an array of real numbers that fits images of `layout`.

    Raises
    ------
    ImageTypeError, ImageError
        See :meth:`PixelWeights.of`.
    """
    _require_real(weights)
    _require_shape(tuple(weights.shape), layout, "image")


def weight_planes(weights: Array, layout: Layout) -> Array:
    """Return weights, shape (H, W) or (*batch, H, W), as planes of shape (N, H, W) for images of `layout`."""
    xp = namespace(weights)
    if layout.channel_axis is not None:
        weights = weights[..., None, :, :]
    return xp.reshape(xp.broadcast_to(weights, layout.planes_shape), (-1, layout.height, layout.width))


def _is_mask(normalised: Array) -> bool:
    return bool(namespace(normalised).all((normalised == 0.0) | (normalised == 1.0)))


def _like(array: Array, like: Array) -> Array:
    """Return an array in the library, dtype and on the device of `like`, which NumPy arrays may lack."""
    if is_numpy_array(array):
        return from_numpy(array, like)
    return array if array.dtype == like.dtype else namespace(array).astype(array, like.dtype)


def _require_shape(shape: tuple[int, ...], layout: Layout, owner: str) -> None:
    size = layout.height, layout.width
    batched = layout.planes_shape if layout.channel_axis is None else (*layout.planes_shape[:-3], *size)
    if shape not in (size, batched):
        allowed = f"{size}" if size == batched else f"{size} or {batched}"
        msg = f"`weights` must have shape {allowed}, one for each pixel of the {owner}, got {shape}"
        raise ImageError(msg)


def _require_valid(weights: Array) -> None:
    xp = namespace(weights)
    if bool(xp.all(xp.isfinite(weights) & (weights >= 0.0))):
        return
    values = to_numpy(weights)
    first = values[~(np.isfinite(values) & (values >= 0.0))][0]
    msg = f"`weights` must be finite and not negative, got {shown(float(first))}"
    raise ImageError(msg)


def _require_real(weights: Any) -> None:
    if not is_array_api_obj(weights):
        msg = f"`weights` must be an array, got {type(weights).__name__}"
        raise ImageTypeError(msg)
    dtype: Any = weights.dtype
    if is_numpy_array(weights):
        is_real = dtype.kind in "fiub"  # the standard's test refuses dtypes that NumPy alone has (object, str)
    else:
        is_real = namespace(weights).isdtype(dtype, ("bool", "integral", "real floating"))
    if not is_real:
        msg = f"`weights` must be real numbers, got {dtype}"
        raise ImageTypeError(msg)

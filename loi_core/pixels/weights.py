"""Weights of pixels, and masks, which are weights of 0 and 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loi_core.errors import ImageError, ImageTypeError
from loi_core.pixels.layout import Layout
from loi_core.support.arrays import Array, Host, from_numpy, is_array_api_obj, is_numpy_array, to_numpy
from loi_core.support.wording import shown

__all__ = ["PixelWeights"]


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
    def of(cls, weights: object, layout: Layout) -> PixelWeights:
        """Return checked weights, shape (*batch, H, W), for a reference of this layout.

        Raises
        ------
        ImageTypeError
            If they are not an array of numbers.
        ImageError
            If the shape does not fit, a weight is negative or not finite, or all are 0.
        """
        values = np.asarray(_real_array(weights)).astype(np.float64)
        size = layout.height, layout.width
        batched = layout.planes_shape if layout.channel_axis is None else (*layout.planes_shape[:-3], *size)
        if values.shape not in (size, batched):
            allowed = f"{size}" if size == batched else f"{size} or {batched}"
            msg = f"`weights` must have shape {allowed}, one for each pixel of the reference, got {values.shape}"
            raise ImageError(msg)
        valid = np.isfinite(values) & (values >= 0.0)
        if not np.all(valid):
            msg = f"`weights` must be finite and not negative, got {shown(float(values[~valid][0]))}"
            raise ImageError(msg)
        largest = float(values.max())
        if largest == 0.0:
            msg = "`weights` must not all be 0: nothing would be compared"
            raise ImageError(msg)
        return cls(values / largest, largest)

    @property
    def is_mask(self) -> bool:
        """Whether all positive weights are equal."""
        return bool(np.all((self.normalised == 0.0) | (self.normalised == 1.0)))

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


def _real_array(weights: object) -> Host:
    """Return weights as a NumPy array of real numbers.

    Raises
    ------
    ImageTypeError
        If they are not an array of numbers.
    """
    if not is_array_api_obj(weights):
        msg = f"`weights` must be an array, got {type(weights).__name__}"
        raise ImageTypeError(msg)
    host: Host = weights if is_numpy_array(weights) else np.asarray(to_numpy(weights))
    if host.dtype.kind not in "fiub":
        msg = f"`weights` must be real numbers, got {host.dtype}"
        raise ImageTypeError(msg)
    return host

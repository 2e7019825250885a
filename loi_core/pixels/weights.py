"""How much each pixel counts: weights, and masks, which are weights of 0 and 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loi_core.errors import ImageError, ImageTypeError
from loi_core.pixels.layout import Layout
from loi_core.support.arrays import Array, Host, from_numpy, is_array_api_obj, to_numpy
from loi_core.support.wording import shown

__all__ = ["PixelWeights"]


@dataclass(frozen=True)
class PixelWeights:
    """Weights of the pixels of an image.

    Attributes
    ----------
    shares : array, shape (*batch, H, W), float64
        The weights in units of the largest, in [0, 1].
    largest : float
        The largest weight.
    """

    shares: Host
    largest: float

    @classmethod
    def of(cls, weights: object, layout: Layout) -> PixelWeights:
        """Weights, shape (*batch, H, W), for a reference of this layout.

        Raises
        ------
        ImageTypeError
            If they are no array of numbers.
        ImageError
            If the shape does not fit, a weight is negative or not finite, or all are 0.
        """
        if not is_array_api_obj(weights):
            msg = f"`weights` must be an array, got {type(weights).__name__}"
            raise ImageTypeError(msg)
        given = np.asarray(to_numpy(weights))
        if given.dtype.kind not in "fiub":
            msg = f"`weights` must be real numbers, got {given.dtype}"
            raise ImageTypeError(msg)
        values = given.astype(np.float64)
        size = layout.height, layout.width
        whole = layout.planes_shape if layout.channel_axis is None else (*layout.planes_shape[:-3], *size)
        if values.shape not in (size, whole):
            wanted = f"{size}" if size == whole else f"{size} or {whole}"
            msg = f"`weights` must have shape {wanted}, one for each pixel of the reference, got {values.shape}"
            raise ImageError(msg)
        if not np.all(np.isfinite(values) & (values >= 0.0)):
            bad = values[~(np.isfinite(values) & (values >= 0.0))][0]
            msg = f"`weights` must be finite and not negative, got {shown(float(bad))}"
            raise ImageError(msg)
        largest = float(values.max())
        if largest == 0.0:
            msg = "`weights` must not all be 0: nothing would be compared"
            raise ImageError(msg)
        return cls(values / largest, largest)

    @property
    def is_mask(self) -> bool:
        """Whether there are only two weights, 0 and another, or only one."""
        return bool(np.all((self.shares == 0.0) | (self.shares == 1.0)))

    @property
    def hide(self) -> bool:
        """Whether any weight is 0."""
        return bool(np.any(self.shares == 0.0))

    @property
    def values(self) -> Host:
        """The weights as they were given, shape (*batch, H, W), float64."""
        return self.shares * self.largest

    def planes(self, layout: Layout, like: Array) -> Array:
        """The shares as planes of shape (N, H, W) of images of `layout`, an array like `like`.

        Raises
        ------
        ImageError
            If the batch axes do not fit those of the images.
        """
        shares = self.shares if layout.channel_axis is None else self.shares[..., None, :, :]
        try:
            stack = np.broadcast_to(shares, layout.planes_shape)
        except ValueError:
            msg = f"`weights` have shape {self.shares.shape}, which does not fit images of shape {layout.shape}"
            raise ImageError(msg) from None
        return from_numpy(np.ascontiguousarray(stack).reshape(-1, layout.height, layout.width), like)

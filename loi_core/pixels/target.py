"""An image to match, with the weights of its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loi_core.io.images import FloatImage
from loi_core.pixels.encoding import Encoding
from loi_core.support.arrays import Array, from_numpy, is_array_api_obj, namespace
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number

__all__ = ["Target", "image_and_weights"]


@suggest_keywords
@dataclass(frozen=True)
class Target:
    """An image to match, which losses and objectives take in place of an array.

    Attributes
    ----------
    image : array, shape (H, W, 3), float64
    weights : array, shape (H, W), float64, optional
        Weight of each pixel.
    encoding : {"linear", "sRGB"}, optional
        Encoding of the image; None if it is unknown.
    notes : tuple of str
        Conversions of the file's values, one line each.
    """

    image: FloatImage
    weights: FloatImage | None = None
    encoding: Encoding | None = None
    notes: tuple[str, ...] = ()


def image_and_weights(target: Target | Array, weights: Any, channel_axis: object) -> tuple[Array, Any]:
    """Return the image and weights of a target; of a :class:`Target` with its channels on `channel_axis`.

    Weights of the call are multiplied by the weights of a :class:`Target`. Any other target is returned unchanged.
    """
    if not isinstance(target, Target):
        return target, weights
    axis = whole_number(channel_axis)
    image = target.image if axis is None or not -3 <= axis < 3 else np.moveaxis(target.image, -1, axis)
    if weights is None or target.weights is None:
        return image, target.weights if weights is None else weights
    array: Any = weights  # which `is_array_api_obj` would narrow to types without a shape
    if not is_array_api_obj(weights) or tuple(array.shape[-2:]) != target.weights.shape:
        return image, weights  # of no image's size, as the loss will say
    xp = namespace(array)
    if not xp.isdtype(array.dtype, "real floating"):
        array = xp.astype(array, xp.float32)
    return image, array * from_numpy(target.weights, array)

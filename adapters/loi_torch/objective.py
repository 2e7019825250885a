"""Any image distance of torch as an objective: LPIPS, torchmetrics, kornia.losses, piq, or a function of two images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from loi_core import ImageObjective, LogTone
from loi_core.errors import OptionError
from loi_core.objectives import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array, from_numpy, to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["Distance", "TorchObjective"]

Distance = Callable[[Tensor, Tensor], Tensor]
"""A function or module of an image and a target, both of shape (N, C, H, W)."""


@suggest_keywords
class TorchObjective(ImageObjective[str]):
    """The distance between images that a torch function or module computes, averaged over the batch.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point; see :class:`loi_core.ImageObjective`, as for the keywords.
    distance : callable
        ``distance(image, target)`` for tensors of shape (N, C, H, W) with unscaled values. It returns a differentiable
        tensor: one value, one for each image, or a map, which is averaged. A module receives tensors in the dtype
        and on the device of its parameters.

    Raises
    ------
    OptionError
        If `distance` is not callable, or returns no differentiable tensor.

    Examples
    --------
    >>> import kornia, numpy as np
    >>> objective = TorchObjective(np.zeros((32, 32, 3)), kornia.losses.SSIMLoss(5))
    >>> value, gradient = objective.value_and_grad(np.full((32, 32, 3), 0.5))
    >>> gradient.shape
    (32, 32, 3)

    Notes
    -----
    Images of any library are compared in torch, tensors on their own device and other arrays on the processor. Autograd
    differentiates ``value`` of a tensor as well.
    """

    def __init__(
        self,
        reference: Array,
        distance: Distance,
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone, weights=weights)
        if not callable(distance):
            msg = f"`distance` must be a function or module of an image and a target, got {shown(distance)}"
            raise OptionError(msg)
        self._distance = distance
        self._channels = 1 if channel_axis is None else self._reference_layout.planes_shape[-3]

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        """See :class:`loi_core.ImageObjective`."""
        with torch.inference_mode(mode=False), torch.no_grad():
            target = _images(_tensor(reference.planes), self._channels, self._distance)
        return _TorchComparison(self._distance, target, self._channels)


@dataclass(frozen=True, eq=False)
class _TorchComparison(PlaneComparison[str]):
    distance: Distance
    target: Tensor
    channels: int

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[str]:
        if not gradient:
            return Evaluation({"distance": _like(planes, self._value(_tensor(planes)))}, None)
        # Tensors made in inference mode cannot be used for gradients later.
        with torch.inference_mode(mode=False), torch.enable_grad():
            leaf = _tensor(planes).clone().requires_grad_()
            value = self._value(leaf)
            if not value.requires_grad:
                msg = "`distance` must return a tensor that is differentiable with respect to the image"
                raise OptionError(msg)
            (slope,) = torch.autograd.grad(value, leaf)
        return Evaluation({"distance": _like(planes, value.detach())}, _like(planes, slope))

    def _value(self, planes: Tensor) -> Tensor:
        with torch.autocast(planes.device.type, enabled=False):
            value = self.distance(_images(planes, self.channels, self.distance), self.target)
        if not isinstance(value, Tensor):
            msg = f"`distance` must return a tensor, got {shown(value)}"
            raise OptionError(msg)
        return value.mean().to(planes)


def _images(planes: Tensor, channels: int, distance: Distance) -> Tensor:
    """Return planes, shape (N * C, H, W), as images (N, C, H, W) in the dtype and on the device of a module."""
    images = planes.reshape(-1, channels, *planes.shape[-2:])
    parameter = next(distance.parameters(), None) if isinstance(distance, torch.nn.Module) else None
    return images if parameter is None else images.to(parameter.device, parameter.dtype)


def _tensor(planes: Array) -> Tensor:
    if isinstance(planes, Tensor):
        return planes.clone() if planes.is_inference() else planes
    return torch.tensor(to_numpy(planes))


def _like(planes: Array, result: Tensor) -> Array:
    return result if isinstance(planes, Tensor) else from_numpy(result.detach().numpy(), planes)

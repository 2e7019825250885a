"""The distance of two images in the features of a network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from loi_core.errors import OptionError
from loi_core.support.wording import shown

__all__ = ["FeatureDistance"]


class FeatureDistance(torch.nn.Module):
    """Mean squared difference of the features of an image and a target, as a distance of :class:`TorchObjective`.

    Parameters
    ----------
    network : callable
        ``network(images)`` for a tensor of shape (N, C, H, W) returns a tensor, or a list, tuple or dict of tensors,
        whose distances are summed. A module keeps its mode; call its ``eval()`` first.

    Raises
    ------
    OptionError
        If `network` returns anything else.

    Examples
    --------
    >>> import numpy as np
    >>> from loi_torch import TorchObjective
    >>> objective = TorchObjective(np.zeros((32, 32, 3)), FeatureDistance(torch.nn.Conv2d(3, 8, 5)))
    >>> float(objective.value(np.zeros((32, 32, 3))))
    0.0
    """

    def __init__(self, network: Callable[[Tensor], Any]) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Return the distance, shape (), of images of shape (N, C, H, W)."""
        with torch.no_grad():
            expected = list(_tensors(self.network(target)))
        pairs = zip(_tensors(self.network(image)), expected, strict=True)
        return torch.stack([(actual - feature).square().mean() for actual, feature in pairs]).sum()


def _tensors(features: Any) -> Iterator[Tensor]:
    if isinstance(features, Tensor):
        yield features
    elif isinstance(features, list | tuple | Mapping):
        for entry in features.values() if isinstance(features, Mapping) else features:
            yield from _tensors(entry)
    else:
        msg = f"`network` must return tensors, or a list or dict of them, got {shown(features)}"
        raise OptionError(msg)

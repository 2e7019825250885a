"""A baseline that matches points: RGBXY (Xing, Luan, Yan, Hu, Qian and Xu, SIGGRAPH Asia 2022)."""

from __future__ import annotations

from typing import Any, Final

import torch
from geomloss import SamplesLoss
from torch import Tensor
from torch.nn import functional

from loi_core.errors import ImageError, OptionError
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.support.arrays import from_numpy, to_numpy
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["RGBXY"]

TRANSPORT_BLUR: Final = 0.01  # in units of the image's side, as in the released code


class RGBXY:
    """Pixels as points (r, g, b, x, y), each attracted to its match in the reference under optimal transport.

    Parameters
    ----------
    reference : array, shape (H, W, 3) or (H, W, 5)
        The image to match. Its points are at the centres of its pixels; further channels are ignored.
    grid : int, optional
        Points along each side: means of blocks of pixels. Every pixel is a point by default, but the transport's time
        and memory grow with the square of the number of points: 32 takes a third of a second, 64 ten, on one core.
    interval : int
        Number of evaluations with a gradient between two matchings; 6 in the released code. With more than 1, an
        evaluation depends on earlier ones.
    weight : float
        Weight of colours against positions in the matching.

    Raises
    ------
    ImageError
        If the reference has a wrong shape, or holds NaN or infinite values; images likewise.
    OptionError
        If another argument is not allowed, such as a `grid` that does not divide both sides.

    Notes
    -----
    Images have five channels, as from :func:`loi_torch.mesh.draw_positions` or a ``MeshRenderer(positions=True)``. The
    value is the mean squared distance of the points from their matches, which are constant in the gradient. The
    matching is entropic transport by geomloss, as in the released code. Exact transport takes a quarter of the time;
    it was better in three columns of Table 3, and worse in three (docs/results/table3.md).
    """

    def __init__(self, reference: Any, *, grid: int | None = None, interval: int = 1, weight: float = 1.0) -> None:
        target = _tensor(reference)
        if target.ndim != 3 or target.shape[2] not in (3, 5):
            msg = f"`reference` must have shape (H, W, 3) or (H, W, 5), got {tuple(target.shape)}"
            raise ImageError(msg)
        _require_finite(target, "reference")
        self._size = target.shape[:2]
        number = None if grid is None else whole_number(grid)
        if grid is not None and (number is None or number < 1 or any(length % number for length in self._size)):
            msg = f"`grid` must divide the sides of the image, {tuple(self._size)}, got {shown(grid)}"
            raise OptionError(msg)
        period, colour_weight = whole_number(interval), real_number(weight)
        if period is None or period < 1:
            msg = f"`interval` must be a whole number, 1 or more, got {shown(interval)}"
            raise OptionError(msg)
        if colour_weight is None or not 0.0 < colour_weight < float("inf"):
            msg = f"`weight` must be a number more than 0, got {shown(weight)}"
            raise OptionError(msg)
        self._grid, self._interval = number, period
        self._scale = torch.tensor([colour_weight] * 3 + [1.0, 1.0], dtype=torch.float64, device=target.device)
        height, width = self._size
        y, x = torch.meshgrid(
            (torch.arange(height, dtype=torch.float64) + 0.5) / height,
            (torch.arange(width, dtype=torch.float64) + 0.5) / width,
            indexing="ij",
        )
        positions = torch.stack([x, y], dim=2).to(target.device)
        self._target = self._points(torch.cat([target[..., :3], positions], dim=2))
        self._loss = SamplesLoss("sinkhorn", blur=TRANSPORT_BLUR, backend="tensorized")
        self._evaluations = 0
        self._matches: Tensor | None = None

    def value(self, image: Any) -> Any:
        """Return the mean squared distance of an image's points, shape (H, W, 5), from their matches, computed anew."""
        points = self._points(self._checked(image))
        return _like(_distance(points, self._match(points)), image)

    def value_and_grad(self, image: Any) -> tuple[Any, Any]:
        """Return the value with the matches of this interval, and its gradient with respect to the image."""
        leaf = self._checked(image).detach().requires_grad_()
        with torch.enable_grad():
            points = self._points(leaf)
            if self._matches is None or self._evaluations % self._interval == 0:
                self._matches = self._match(points)
            self._evaluations += 1
            value = _distance(points, self._matches)
            (gradient,) = torch.autograd.grad(value, leaf)
        return _like(value, image), _like(gradient, image)

    def _match(self, points: Tensor) -> Tensor:
        """Return the match of each point, shape (N, 5): the point minus N times the gradient of the transport cost."""
        scaled = (points.detach() * self._scale).to(torch.float32).requires_grad_()
        with torch.enable_grad():
            cost = self._loss(scaled, (self._target * self._scale).to(torch.float32)) * len(scaled)
            (slope,) = torch.autograd.grad(cost, scaled)
        return (scaled.detach() - slope).to(torch.float64) / self._scale

    def _points(self, image: Tensor) -> Tensor:
        if self._grid is not None:
            block = [length // self._grid for length in self._size]
            image = functional.avg_pool2d(image.movedim(2, 0)[None], block)[0].movedim(0, 2)
        return image.reshape(-1, 5)

    def _checked(self, image: Any) -> Tensor:
        tensor = _tensor(image)
        if tuple(tensor.shape) != (*self._size, 5):
            expected = (*self._size, 5)
            msg = f"`image` must have shape {expected}, red, green, blue, x and y, got {tuple(tensor.shape)}"
            raise ImageError(msg)
        _require_finite(tensor, "image")
        return tensor


def _distance(points: Tensor, matches: Tensor) -> Tensor:
    return ((points - matches) ** 2).mean()


def _require_finite(tensor: Tensor, name: str) -> None:
    number = count_non_finite(tensor)
    if number:
        msg = f"`{name}` must have finite numbers, got {number} that are not finite"
        raise ImageError(msg)


def _tensor(image: Any) -> Tensor:
    tensor = image if isinstance(image, Tensor) else torch.as_tensor(to_numpy(image))
    return tensor.to(torch.float64)


def _like(value: Tensor, image: Any) -> Any:
    """Return `value` in the library and dtype of `image`."""
    detached = value.detach()
    return detached.to(image) if isinstance(image, Tensor) else from_numpy(to_numpy(detached), image)

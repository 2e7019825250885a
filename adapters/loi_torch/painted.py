"""Base of torch renderers: a scene on the host with its checks, an image and its pullback by autograd."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, TypeAlias

import torch
from torch import Tensor

from loi_core.errors import ParameterError
from loi_core.renderers.contract import RendererCapabilities
from loi_core.renderers.validation import FloatArray
from loi_core.support.arrays import to_numpy

__all__ = ["HostScene", "Painted", "Tensors"]

Tensors: TypeAlias = dict[str, Tensor]


class HostScene(Protocol):
    """Parameters of a scene as NumPy arrays, with their checks."""

    def parameters(self) -> dict[str, FloatArray]:
        """Return all parameters in new arrays."""

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """Return `params` as new float64 arrays; raise an error if they are no valid scene."""

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the legal parameters nearest to `params`."""


class Painted(abc.ABC):
    """A renderer that paints in torch; a scene on the host provides checks, parameters and :meth:`project`."""

    backend: ClassVar[str] = "torch"

    def __init__(self, scene: HostScene, dtype: str, device: str) -> None:
        self._scene = scene
        self._dtype: torch.dtype = getattr(torch, dtype)
        self._device = _check_device(device)

    @property
    def capabilities(self) -> RendererCapabilities:
        """A fit calls :meth:`project` after every step."""
        return RendererCapabilities(project=self.project)

    def parameters(self) -> Tensors:
        """Return the parameters of the scene in its dtype."""
        return _tensors(self._scene.parameters(), self._dtype, self._device)

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:
        """Return the detached image, shape (height, width, 3); `seed` is unused, because nothing is random."""
        with torch.no_grad():
            return self._paint(self._checked(params)).to(self._dtype)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
        """Return the image and its pullback, both detached; see :class:`loi_core.Renderer`."""
        return _vjp(self._paint, self._checked(params), self._dtype)

    def project(self, params: Tensors) -> Tensors:
        """Return the legal parameters nearest to `params`."""
        return _tensors(self._scene.project(_host(params)), self._dtype, self._device)

    def _checked(self, params: Tensors) -> Tensors:
        return _tensors(self._scene.checked(_host(params)), torch.float64, self._device)

    @abc.abstractmethod
    def _paint(self, scene: Tensors) -> Tensor:
        """Return the image in float64, differentiable by autograd."""


def _vjp(
    paint: Callable[[Tensors], Tensor], scene: Tensors, dtype: torch.dtype
) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
    """Return image and pullback in `dtype` of a function that computes in float64."""
    leaves = {name: value.requires_grad_() for name, value in scene.items()}
    with torch.enable_grad():
        image = paint(leaves)

    def pullback(cotangent: Tensor) -> Tensors:
        weights = torch.as_tensor(cotangent).detach()
        if weights.shape != image.shape:
            msg = f"`cotangent` must have the image's shape, {tuple(image.shape)}, got {tuple(weights.shape)}"
            raise ParameterError(msg)
        if not image.requires_grad:  # a scene without disks
            return {name: torch.zeros_like(leaf, dtype=dtype) for name, leaf in leaves.items()}
        slopes = torch.autograd.grad(
            image,
            list(leaves.values()),
            weights.to(image),
            retain_graph=True,  # a pullback may be called again
            materialize_grads=True,  # unused parameters, such as the width of a stroke without length, get 0
        )
        return {name: slope.to(dtype) for name, slope in zip(leaves, slopes, strict=True)}

    return image.detach().to(dtype), pullback


def _host(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: to_numpy(value) for name, value in params.items()}


def _tensors(values: Mapping[str, FloatArray], dtype: torch.dtype, device: torch.device) -> Tensors:
    return {name: torch.tensor(value, dtype=dtype, device=device) for name, value in values.items()}


def _check_device(name: object) -> torch.device:
    """Return the device of that name if torch can create float64 numbers there."""
    try:
        if isinstance(name, str):
            number = torch.zeros((), dtype=torch.float64, device=name)
            number.item()  # a device such as "meta" has shapes and no numbers
            return number.device
    except (AssertionError, NotImplementedError, RuntimeError, TypeError):  # which one depends on torch's build
        pass
    msg = f"`device` must name a device of torch with float64, got {name!r}"
    raise ParameterError(msg)

"""What all renderers on torch share: a scene on the host with its checks, an image and pullback by autograd."""

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
    """A scene's parameters as NumPy arrays, and the rules that they keep."""

    def parameters(self) -> dict[str, FloatArray]:
        """All parameters; new arrays on each call."""

    def checked(self, params: Mapping[str, object]) -> dict[str, FloatArray]:
        """`params` as new float64 arrays, once they are known to be a scene that can be rendered."""

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """The legal parameters next to `params`."""


class Painted(abc.ABC):
    """A renderer whose picture torch paints: checks, parameters and :meth:`project` are a scene's on the host."""

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
        """The parameters of the scene, of its dtype."""
        return _tensors(self._scene.parameters(), self._dtype, self._device)

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:
        """The image, shape (height, width, 3), detached; `seed` is not needed, nothing is random."""
        with torch.no_grad():
            return self._paint(self._checked(params)).to(self._dtype)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
        """The image and its pullback, both detached; see :class:`loi_core.Renderer`."""
        return _vjp(self._paint, self._checked(params), self._dtype)

    def project(self, params: Tensors) -> Tensors:
        """The legal parameters next to `params`, as the scene has them."""
        return _tensors(self._scene.project(_host(params)), self._dtype, self._device)

    def _checked(self, params: Tensors) -> Tensors:
        return _tensors(self._scene.checked(_host(params)), torch.float64, self._device)

    @abc.abstractmethod
    def _paint(self, scene: Tensors) -> Tensor:
        """The image, float64, for autograd."""


def _vjp(
    paint: Callable[[Tensors], Tensor], scene: Tensors, dtype: torch.dtype
) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
    """Image and pullback in `dtype` of a function whose arithmetic is float64."""
    leaves = {name: value.requires_grad_() for name, value in scene.items()}
    with torch.enable_grad():
        image = paint(leaves)

    def pullback(cotangent: Tensor) -> Tensors:
        given = torch.as_tensor(cotangent).detach()
        if given.shape != image.shape:
            msg = f"`cotangent` must have the image's shape, {tuple(image.shape)}, got {tuple(given.shape)}"
            raise ParameterError(msg)
        if not image.requires_grad:  # a scene without disks
            return {name: torch.zeros_like(leaf, dtype=dtype) for name, leaf in leaves.items()}
        slopes = torch.autograd.grad(
            image,
            list(leaves.values()),
            given.to(image),
            retain_graph=True,  # a pullback may be called again
            materialize_grads=True,  # what a scene has no use for, such as the width of a stroke of no length, gets 0
        )
        return {name: slope.to(dtype) for name, slope in zip(leaves, slopes, strict=True)}

    return image.detach().to(dtype), pullback


def _host(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: to_numpy(value) for name, value in params.items()}


def _tensors(values: Mapping[str, FloatArray], dtype: torch.dtype, device: torch.device) -> Tensors:
    return {name: torch.tensor(value, dtype=dtype, device=device) for name, value in values.items()}


def _check_device(name: object) -> torch.device:
    """The device of that name, once torch has made a float64 number there."""
    try:
        if isinstance(name, str):
            made = torch.zeros((), dtype=torch.float64, device=name)
            made.item()  # a device such as "meta" has shapes and no numbers
            return made.device
    except (AssertionError, NotImplementedError, RuntimeError, TypeError):  # which one depends on torch's build
        pass
    msg = f"`device` must be the name of one on which torch can compute in float64, got {name!r}"
    raise ParameterError(msg)

"""Disks and warped pictures on torch, the same images as those of `loi_core.renderers`, on any of torch's devices."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, TypeAlias

import numpy as np
import torch
from kornia.geometry.transform import remap
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from loi_core import renderers as core
from loi_core.arrays import to_numpy
from loi_core.errors import ParameterError
from loi_core.renderers.checks import FloatArray
from loi_core.renderers.coverage import disk_coverage
from loi_core.renderers.fragments import Fragments, disk_fragments

__all__ = ["Disks", "Warp"]

Tensors: TypeAlias = dict[str, Tensor]


class _Painted(abc.ABC):
    """A renderer of the core whose picture torch paints: checks, parameters and :meth:`project` are the core's."""

    backend: ClassVar[str] = "torch"

    def __init__(self, scene: core.Disks | core.Warp, dtype: str, device: str) -> None:
        self._core = scene
        self._dtype: torch.dtype = getattr(torch, dtype)
        self._device = _check_device(device)

    def parameters(self) -> Tensors:
        """The parameters of the core's renderer, of the scene's dtype."""
        return _tensors(self._core.parameters(), self._dtype, self._device)

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:
        """The image, shape (height, width, 3), detached; `seed` is not needed, nothing is random."""
        with torch.no_grad():
            return self._paint(self._checked(params)).to(self._dtype)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
        """The image and its pullback, both detached; see :class:`loi_core.Renderer`."""
        return _vjp(self._paint, self._checked(params), self._dtype)

    def project(self, params: Tensors) -> Tensors:
        """The legal parameters next to `params`, as the core's renderer has them."""
        return _tensors(self._core.project(_host(params)), self._dtype, self._device)

    def _checked(self, params: Tensors) -> Tensors:
        return _tensors(self._core.checked(_host(params)), torch.float64, self._device)

    @abc.abstractmethod
    def _paint(self, scene: Tensors) -> Tensor:
        """The image, float64, for autograd."""


class Disks(_Painted):
    """`n` disks over a plain background, the later ones on top: :class:`loi_core.renderers.Disks` on torch.

    Parameters
    ----------
    height, width, positions, radii, colours, background, dtype, confine
        See :class:`loi_core.renderers.Disks`; the parameters and the image are the same, as tensors.
    device : str
        Where torch computes; one that has float64.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or torch cannot use the device.

    Notes
    -----
    Only pixels that a disk meets are painted. Which they are is found on the host.
    """

    def __init__(
        self,
        height: int,
        width: int,
        positions: Sequence[Sequence[float]] | FloatArray,
        radii: float | Sequence[float] | FloatArray,
        colours: Sequence[Sequence[float]] | FloatArray,
        background: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        *,
        dtype: str = "float64",
        confine: bool = False,
        device: str = "cpu",
    ) -> None:
        scene = core.Disks(height, width, positions, radii, colours, background, dtype=dtype, confine=confine)
        super().__init__(scene, dtype, device)
        self._size = scene.size
        self._canvas = torch.tensor(scene.background, device=self._device).expand(scene.size[0] * scene.size[1], 3)

    def _paint(self, scene: Tensors) -> Tensor:
        fragments = disk_fragments(to_numpy(scene["positions"]), to_numpy(scene["radii"]), self._size)
        owner = torch.tensor(fragments.owner, device=self._device)
        pixels = torch.tensor(fragments.rows * self._size[1] + fragments.columns, device=self._device)
        coverage: Tensor = _Coverage.apply(scene["positions"], scene["radii"], fragments)[0]  # type: ignore[no-untyped-call]  # untyped in torch
        share, colours = coverage[:, None], scene["colours"][owner]
        image = self._canvas
        for layer in fragments.layers:
            beneath = image[pixels[layer]]
            image = image.index_put((pixels[layer],), beneath + share[layer] * (colours[layer] - beneath))
        return image.reshape(*self._size, 3)


class Warp(_Painted):
    """A picture over a background, moved, turned and scaled: :class:`loi_core.renderers.Warp` on torch.

    Parameters
    ----------
    picture, background, translation, rotation, scale, exposure, dtype
        See :class:`loi_core.renderers.Warp`; the parameters and the image are the same, as tensors.
    device : str
        Where torch computes; one that has float64.

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
        self._layers = torch.tensor(_widened(scene.layers), device=self._device)

    def _paint(self, pose: Tensors) -> Tensor:
        height, width = self._background.shape[:2]
        across = torch.arange(width, dtype=torch.float64, device=self._device) + 0.5 - 0.5 * width
        down = torch.arange(height, dtype=torch.float64, device=self._device) + 0.5 - 0.5 * height
        right = across - pose["translation"][0]
        low = down[:, None] - pose["translation"][1]
        angle = torch.deg2rad(pose["rotation"])
        cos, sin = torch.cos(angle), torch.sin(angle)
        # The layers' first row and column are the rim, so the picture's pixel (0, 0) is their (1, 1).
        x = (cos * right + sin * low) / pose["scale"] + (0.5 * self._size[1] + 0.5)
        y = (cos * low - sin * right) / pose["scale"] + (0.5 * self._size[0] + 0.5)
        sampled = remap(self._layers, x[None], y[None], mode="bilinear", padding_mode="zeros", align_corners=True)
        layers = sampled[0].movedim(0, -1)
        return torch.exp2(pose["exposure"]) * (layers[..., :3] + (1.0 - layers[..., 3:]) * self._background)


class _Coverage(torch.autograd.Function):
    """The core's areas with the core's derivatives: autograd's own are NaN where a square root starts."""

    @staticmethod
    def forward(positions: Tensor, radii: Tensor, fragments: Fragments) -> tuple[Tensor, ...]:
        edge = np.flatnonzero(fragments.on_edge)
        where, owner = (torch.tensor(each, device=radii.device) for each in (edge, fragments.owner[edge]))
        x, y = (
            torch.tensor(pixels[edge, None] + np.arange(2.0), device=radii.device) - centres[owner, None]
            for pixels, centres in zip((fragments.columns, fragments.rows), positions.unbind(dim=1), strict=True)
        )
        parts = disk_coverage(x[:, None, :], y[:, :, None], radii[owner, None, None])
        area, *slopes = (part[:, 0, 0] for part in parts)
        coverage = radii.new_ones(len(fragments.owner)).index_put((where,), area)
        return coverage, where, owner, *slopes

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(inputs[1], *output[1:])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        """Weigh the derivatives; differentiating this again is an error, since they are constants to autograd."""
        radii, where, owner, *slopes = ctx.saved_tensors
        by_x, by_y, by_radius = (
            torch.zeros_like(radii).index_add(0, owner, upstream[where] * slope) for slope in slopes
        )
        return torch.stack([by_x, by_y], dim=-1), by_radius, None


def _vjp(
    paint: Callable[[Tensors], Tensor], scene: Tensors, dtype: torch.dtype
) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
    """Image and pullback in `dtype` of a function whose arithmetic is float64."""
    leaves = {name: value.requires_grad_() for name, value in scene.items()}
    with torch.enable_grad():
        image = paint(leaves)

    def pullback(cotangent: Tensor) -> Tensors:
        if not image.requires_grad:  # a scene without disks
            return {name: torch.zeros_like(leaf, dtype=dtype) for name, leaf in leaves.items()}
        slopes = torch.autograd.grad(
            image,
            list(leaves.values()),
            torch.as_tensor(cotangent).detach().to(image),
            retain_graph=True,  # a pullback may be called again
        )
        return {name: slope.to(dtype) for name, slope in zip(leaves, slopes, strict=True)}

    return image.detach().to(dtype), pullback


def _widened(layers: FloatArray) -> FloatArray:
    """`layers`, shape (h, w, 4), as kornia wants them, (1, 4, h', w'), with a transparent rim.

    The rim is widened at the right and below to sides of 2^k + 1 pixels: Kornia's way to coordinates in [-1, 1] and
    back is then free of rounding at the centres of pixels, where rounding would pick the derivative on either side.
    """
    rims = [(1, 2 ** int(size).bit_length() - size) for size in layers.shape[:2]]
    return np.moveaxis(np.pad(layers, (*rims, (0, 0))), -1, 0)[None]


def _host(params: Mapping[str, Any]) -> dict[str, Any]:
    return {name: to_numpy(value) for name, value in params.items()}


def _tensors(values: Mapping[str, FloatArray], dtype: torch.dtype, device: torch.device) -> Tensors:
    return {name: torch.tensor(value, dtype=dtype, device=device) for name, value in values.items()}


def _check_device(name: object) -> torch.device:
    """The device of that name, once torch has made a float64 number there."""
    try:
        if isinstance(name, str):
            return torch.zeros((), dtype=torch.float64, device=name).device
    except (AssertionError, NotImplementedError, RuntimeError, TypeError):  # which one depends on torch's build
        pass
    msg = f"`device` must be the name of one on which torch can compute in float64, got {name!r}"
    raise ParameterError(msg)

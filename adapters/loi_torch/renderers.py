"""Disks and warped pictures on torch, the same images as those of `loi_core.renderers`, on any of torch's devices."""

from __future__ import annotations

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
from loi_core.renderers.checks import FloatArray, check_image, check_parameters
from loi_core.renderers.coverage import canvas_coverage

__all__ = ["Disks", "Warp"]

Tensors: TypeAlias = dict[str, Tensor]


class Disks:
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
    Every disk is painted on the whole canvas, so that no shape depends on a value; memory grows with n times the
    number of pixels.
    """

    backend: ClassVar[str] = "torch"

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
        self._core = core.Disks(height, width, positions, radii, colours, background, dtype=dtype, confine=confine)
        self._dtype: torch.dtype = getattr(torch, dtype)
        self._device = _check_device(device)
        rows, columns = self._core.size
        self._canvas = torch.tensor(self._core.background, device=self._device).expand(rows, columns, 3)
        self._rows = torch.arange(rows + 1, dtype=torch.float64, device=self._device)
        self._columns = torch.arange(columns + 1, dtype=torch.float64, device=self._device)

    def parameters(self) -> Tensors:
        """``positions`` (n, 2), ``radii`` (n,) and ``colours`` (n, 3), of the scene's dtype."""
        return _tensors(self._core.parameters(), self._dtype, self._device)

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:
        """The image, shape (height, width, 3), detached; `seed` is not needed, nothing is random."""
        with torch.no_grad():
            return self._paint(self._checked(params)).to(self._dtype)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
        """The image and its pullback, both detached; see :class:`loi_core.Renderer`."""
        return _vjp(self._paint, self._checked(params), self._dtype)

    def project(self, params: Tensors) -> Tensors:
        """The legal parameters next to `params`; see :meth:`loi_core.renderers.Disks.project`."""
        return _tensors(self._core.project(_host(params)), self._dtype, self._device)

    def _checked(self, params: Tensors) -> Tensors:
        return _tensors(check_parameters(_host(params), self._core.parameters()), torch.float64, self._device)

    def _paint(self, scene: Tensors) -> Tensor:
        coverage: Tensor = _Coverage.apply(scene["positions"], scene["radii"], self._columns, self._rows)[0]  # type: ignore[no-untyped-call]  # untyped in torch
        image = self._canvas
        for share, colour in zip(coverage[..., None], scene["colours"], strict=True):
            image = image + share * (colour - image)
        return image


class Warp:
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

    backend: ClassVar[str] = "torch"

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
        self._core = core.Warp(picture, background, translation, rotation, scale, exposure, dtype=dtype)
        self._dtype: torch.dtype = getattr(torch, dtype)
        self._device = _check_device(device)
        self._background = torch.tensor(check_image("background", background, (3,)), device=self._device)
        host = check_image("picture", picture, (3, 4))
        self._size = host.shape[:2]
        self._layers = torch.tensor(_layers(host), device=self._device)

    def parameters(self) -> Tensors:
        """``translation`` (2,), ``rotation`` (), ``scale`` () and ``exposure`` (), of the scene's dtype."""
        return _tensors(self._core.parameters(), self._dtype, self._device)

    def render(self, params: Tensors, *, seed: int = 0) -> Tensor:
        """The image, shape (H, W, 3), detached; `seed` is not needed, nothing is random."""
        with torch.no_grad():
            return self._paint(self._checked(params)).to(self._dtype)

    def render_vjp(self, params: Tensors, *, seed: int = 0) -> tuple[Tensor, Callable[[Tensor], Tensors]]:
        """The image and its pullback, both detached; see :class:`loi_core.Renderer`."""
        return _vjp(self._paint, self._checked(params), self._dtype)

    def project(self, params: Tensors) -> Tensors:
        """The legal parameters next to `params`; see :meth:`loi_core.renderers.Warp.project`."""
        return _tensors(self._core.project(_host(params)), self._dtype, self._device)

    def _checked(self, params: Tensors) -> Tensors:
        pose = check_parameters(_host(params), self._core.parameters())
        if pose["scale"] <= 0.0:
            msg = f"`scale` must be more than 0, got {float(pose['scale'])}"
            raise ParameterError(msg)
        return _tensors(pose, torch.float64, self._device)

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
    def forward(positions: Tensor, radii: Tensor, columns: Tensor, rows: Tensor) -> tuple[Tensor, ...]:
        return canvas_coverage(positions, radii, columns, rows)

    @staticmethod
    def setup_context(ctx: FunctionCtx, _: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*output[1:])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        """Weigh the derivatives; differentiating this again is an error, since they are constants to autograd."""
        by_x, by_y, by_radius = (torch.sum(upstream * slope, dim=(-2, -1)) for slope in ctx.saved_tensors)
        return torch.stack([by_x, by_y], dim=-1), by_radius, None, None


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


def _layers(picture: FloatArray) -> FloatArray:
    """Premultiplied RGB and opacity, shape (1, 4, h', w'), with a transparent rim.

    The rim is widened at the right and below to sides of 2^k + 1 pixels: Kornia's way to coordinates in [-1, 1] and
    back is then free of rounding at the centres of pixels, where rounding would pick the derivative on either side.
    """
    opacity = picture[..., 3:] if picture.shape[2] == 4 else np.ones((*picture.shape[:2], 1))
    layered = np.concatenate([picture[..., :3] * opacity, opacity], axis=-1)
    rims = [(1, 2 ** int(size).bit_length() - size) for size in picture.shape[:2]]
    return np.moveaxis(np.pad(layered, (*rims, (0, 0))), -1, 0)[None]


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

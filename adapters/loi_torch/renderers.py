"""Disks on torch, equal to the image of `loi_core.renderers.Disks`, on any of torch's devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from loi_core import renderers as core
from loi_core.renderers.coverage import disk_coverage
from loi_core.renderers.rasterization import Fragments, rasterize_disks
from loi_core.renderers.validation import FloatArray
from loi_core.support.arrays import to_numpy
from loi_core.support.keywords import suggest_keywords
from loi_torch.compositing import composite_fragments
from loi_torch.painted import Painted, Tensors

__all__ = ["Disks"]


@suggest_keywords
class Disks(Painted):
    """`n` disks over a plain background, the later ones on top: :class:`loi_core.renderers.Disks` on torch.

    Parameters
    ----------
    height, width, positions, radii, colours, background, dtype, confine
        See :class:`loi_core.renderers.Disks`; the parameters and the image are the same, as tensors.
    device : str
        A device of torch with float64.

    Raises
    ------
    ParameterError
        If a value has a wrong shape or is not finite, or torch cannot use the device.

    Notes
    -----
    Only pixels that a disk meets are painted. The host determines these pixels.
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
        self._background = torch.tensor(scene.background, device=self._device)

    def _paint(self, scene: Tensors) -> Tensor:
        fragments = rasterize_disks(to_numpy(scene["positions"]), to_numpy(scene["radii"]), self._size)
        owner = torch.tensor(fragments.owner, device=self._device)
        pixels = torch.tensor(fragments.rows * self._size[1] + fragments.columns, device=self._device)
        coverage: Tensor = _Coverage.apply(scene["positions"], scene["radii"], fragments)[0]  # type: ignore[no-untyped-call]  # untyped in torch
        height, width = self._size
        image = composite_fragments(
            coverage, scene["colours"][owner], self._background, pixels, fragments.layers, height * width
        )
        return image.reshape(*self._size, 3)


class _Coverage(torch.autograd.Function):
    """The core's areas with the core's derivatives, because autograd's derivatives of square roots are NaN at 0."""

    @staticmethod
    def forward(positions: Tensor, radii: Tensor, fragments: Fragments) -> tuple[Tensor, ...]:
        edge = np.flatnonzero(fragments.on_edge)
        where, owner = (torch.tensor(index, device=radii.device) for index in (edge, fragments.owner[edge]))
        x, y = (
            torch.tensor(pixels[edge, None] + np.arange(2.0), device=radii.device) - centres[owner, None]
            for pixels, centres in zip((fragments.columns, fragments.rows), positions.unbind(dim=1), strict=True)
        )
        values = disk_coverage(x[:, None, :], y[:, :, None], radii[owner, None, None])
        area, *slopes = (value[:, 0, 0] for value in values)
        coverage = radii.new_ones(len(fragments.owner)).index_put((where,), area)
        return coverage, where, owner, *slopes

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(inputs[1], *output[1:])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        """Scale the derivatives, which are constants to autograd, so differentiating again is an error."""
        radii, where, owner, *slopes = ctx.saved_tensors
        by_x, by_y, by_radius = (
            torch.zeros_like(radii).index_add(0, owner, upstream[where] * slope) for slope in slopes
        )
        return torch.stack([by_x, by_y], dim=-1), by_radius, None

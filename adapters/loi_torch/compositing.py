"""Compositing of fragments over each other, for torch renderers."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

__all__ = ["composite_fragments"]


def composite_fragments(
    coverage: Tensor, colours: Tensor, background: Tensor, pixels: Tensor, layers: tuple[slice, ...], count: int
) -> Tensor:
    """Composite fragments over a background.

    Parameters
    ----------
    coverage : tensor, shape (f,)
        Coverage of its pixel by each fragment, times its opacity.
    colours : tensor, shape (f, 3)
        Linear RGB of each fragment.
    background : tensor, shape (3,) or (count, 3)
        Linear RGB; it has no gradient.
    pixels : tensor of int, shape (f,)
        Pixel index of each fragment.
    layers : tuple of slice
        Fragments of each layer, lowest first; no pixel occurs twice in a layer
        (:func:`loi_core.renderers.rasterization.peel_layers`).
    count : int
        Number of pixels.

    Returns
    -------
    tensor, shape (count, 3)
    """
    image: Tensor = _Over.apply(coverage, colours, background, pixels, layers, count)[0]  # type: ignore[no-untyped-call]  # untyped in torch
    return image


class _Over(torch.autograd.Function):
    """Composite with a closed-form adjoint; autograd would store the whole image for every layer."""

    @staticmethod
    def forward(
        coverage: Tensor, colours: Tensor, background: Tensor, pixels: Tensor, layers: tuple[slice, ...], count: int
    ) -> tuple[Tensor, Tensor]:
        image = background.expand(count, 3).clone()
        contrast = torch.empty_like(colours)
        for layer in layers:
            beneath = image[pixels[layer]]
            contrast[layer] = colours[layer] - beneath
            image[pixels[layer]] = beneath + coverage[layer, None] * contrast[layer]
        return image, contrast

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        coverage, _, _, pixels, layers, _ = inputs
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(coverage, output[1], pixels)
        ctx.layers = layers  # type: ignore[attr-defined]  # torch keeps attributes

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """Propagate from the highest layer to the lowest, attenuated by the fragments above."""
        coverage, contrast, pixels = ctx.saved_tensors
        transmitted = upstream.clone()
        arriving = torch.empty_like(contrast)
        for layer in reversed(ctx.layers):
            arriving[layer] = transmitted[pixels[layer]]
            transmitted[pixels[layer]] = arriving[layer] * (1.0 - coverage[layer, None])
        return torch.sum(arriving * contrast, dim=1), arriving * coverage[:, None], None, None, None, None

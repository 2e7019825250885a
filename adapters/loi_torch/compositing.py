"""Painting fragments over one another, for every renderer on torch that has them."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

__all__ = ["painted_over"]


def painted_over(
    share: Tensor, colours: Tensor, background: Tensor, pixels: Tensor, layers: tuple[slice, ...], count: int
) -> Tensor:
    """Paint fragments over a background.

    Parameters
    ----------
    share : tensor, shape (f,)
        How much of its pixel each fragment covers, times its opacity.
    colours : tensor, shape (f, 3)
        Linear RGB of each fragment.
    background : tensor, shape (3,) or (count, 3)
        Linear RGB; it has no gradient.
    pixels : tensor of int, shape (f,)
        Where each fragment lies.
    layers : tuple of slice
        The fragments of each layer, lowest first, in which no pixel comes twice
        (:func:`loi_core.renderers.rasterization.peel_layers`).
    count : int
        Of pixels.

    Returns
    -------
    tensor, shape (count, 3)
    """
    image: Tensor = _Over.apply(share, colours, background, pixels, layers, count)[0]  # type: ignore[no-untyped-call]  # untyped in torch
    return image


class _Over(torch.autograd.Function):
    """Fragments over one another: autograd would keep the whole image for every layer."""

    @staticmethod
    def forward(
        share: Tensor, colours: Tensor, background: Tensor, pixels: Tensor, layers: tuple[slice, ...], count: int
    ) -> tuple[Tensor, Tensor]:
        image = background.expand(count, 3).clone()
        contrast = torch.empty_like(colours)
        for layer in layers:
            beneath = image[pixels[layer]]
            contrast[layer] = colours[layer] - beneath
            image[pixels[layer]] = beneath + share[layer, None] * contrast[layer]
        return image, contrast

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        share, _, _, pixels, layers, _ = inputs
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(share, output[1], pixels)
        ctx.layers = layers  # type: ignore[attr-defined]  # torch keeps what is put there

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """From the highest layer to the lowest: what arrives at a fragment is what those above let through."""
        share, contrast, pixels = ctx.saved_tensors
        flowing = upstream.clone()
        arriving = torch.empty_like(contrast)
        for layer in reversed(ctx.layers):
            arriving[layer] = flowing[pixels[layer]]
            flowing[pixels[layer]] = arriving[layer] * (1.0 - share[layer, None])
        return torch.sum(arriving * contrast, dim=1), arriving * share[:, None], None, None, None, None

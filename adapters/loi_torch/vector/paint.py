"""Colours of fragments, and painting them over one another."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from loi_torch.vector.coverage import Painting

__all__ = ["bilinear", "composite"]


def bilinear(corners: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """Colours between those of four corners.

    Parameters
    ----------
    corners : tensor, shape (4, 4)
        Left top, right top, left bottom, right bottom.
    across, down : tensor, shape (m,)
        Place in the box; 0 is left or top, 1 is right or bottom, and beyond it the colour is that of the rim.
    """
    u, v = torch.clamp(across, 0.0, 1.0)[:, None], torch.clamp(down, 0.0, 1.0)[:, None]
    top = corners[0] + u * (corners[1] - corners[0])
    bottom = corners[2] + u * (corners[3] - corners[2])
    return top + v * (bottom - top)


def composite(colours: Tensor, painting: Painting, background: Tensor, count: int) -> Tensor:
    """Paint fragments over a plain background.

    Parameters
    ----------
    colours : tensor, shape (f, 4)
        Linear RGB and opacity of each fragment.
    painting : Painting
    background : tensor, shape (3,)
        Linear RGB.
    count : int
        Of pixels.

    Returns
    -------
    tensor, shape (count, 3)
    """
    share = painting.coverage * colours[:, 3]
    pixels = torch.as_tensor(painting.pixels, device=colours.device)
    image: Tensor = _Over.apply(share, colours[:, :3], background, pixels, painting.sheets, count)[0]  # type: ignore[no-untyped-call]  # untyped in torch
    return image


class _Over(torch.autograd.Function):
    """Fragments over one another: autograd would keep the whole image for every sheet."""

    @staticmethod
    def forward(
        share: Tensor, colours: Tensor, background: Tensor, pixels: Tensor, sheets: tuple[slice, ...], count: int
    ) -> tuple[Tensor, Tensor]:
        image = background.expand(count, 3).clone()
        contrast = torch.empty_like(colours)
        for sheet in sheets:
            beneath = image[pixels[sheet]]
            contrast[sheet] = colours[sheet] - beneath
            image[pixels[sheet]] = beneath + share[sheet, None] * contrast[sheet]
        return image, contrast

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        share, _, _, pixels, sheets, _ = inputs
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(share, output[1], pixels)
        ctx.sheets = sheets  # type: ignore[attr-defined]  # torch keeps what is put there

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """From the highest sheet to the lowest: what arrives at a fragment is what those above let through."""
        share, contrast, pixels = ctx.saved_tensors
        flowing = upstream.clone()
        arriving = torch.empty_like(contrast)
        for sheet in reversed(ctx.sheets):
            arriving[sheet] = flowing[pixels[sheet]]
            flowing[pixels[sheet]] = arriving[sheet] * (1.0 - share[sheet, None])
        return torch.sum(arriving * contrast, dim=1), arriving * share[:, None], None, None, None, None

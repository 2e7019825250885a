"""Colours of fragments, and painting them over one another."""

from __future__ import annotations

import torch
from torch import Tensor

from loi_torch.compositing import composite_fragments
from loi_torch.vector.coverage import Painting

__all__ = ["bilinear", "composite"]


def bilinear(corners: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Interpolate the colours of four corners.

    Parameters
    ----------
    corners : tensor, shape (4, 4)
        Left top, right top, left bottom, right bottom.
    across, down : tensor, shape (m,)
        Position in the box; 0 is left or top, 1 is right or bottom; beyond the box, the colour of its rim.
    """
    u, v = torch.clamp(u, 0.0, 1.0)[:, None], torch.clamp(v, 0.0, 1.0)[:, None]
    top = corners[0] + u * (corners[1] - corners[0])
    bottom = corners[2] + u * (corners[3] - corners[2])
    return top + v * (bottom - top)


def composite(colours: Tensor, painting: Painting, background: Tensor, count: int) -> Tensor:
    """Paint fragments over a background.

    Parameters
    ----------
    colours : tensor, shape (f, 4)
        Linear RGB and opacity of each fragment.
    painting : Painting
    background : tensor, shape (3,) or (count, 3)
        Linear RGB.
    count : int
        Of pixels.

    Returns
    -------
    tensor, shape (count, 3)
    """
    share = painting.coverage * colours[:, 3]
    pixels = torch.as_tensor(painting.pixels, device=colours.device)
    return composite_fragments(share, colours[:, :3], background, pixels, painting.sheets, count)

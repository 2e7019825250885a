"""The loss of kornia's ``ImageRegistrator``, over the part of the target that the warped image covers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from loi_core import ScaleSpace
from loi_core.errors import ImageError
from loi_core.support.keywords import suggest_keywords
from loi_torch.kornia.losses import loi_loss

__all__ = ["RegistrationLoss"]

COVERED: Final = 0.9  # of a pixel: ImageRegistrator's threshold
BILINEAR: Final = 0  # torch's number of the interpolation
ZEROS: Final = 0  # torch's number of the padding


@suggest_keywords
class RegistrationLoss(nn.Module):
    """The locally orderless image loss as ``loss_fn`` of kornia's ``ImageRegistrator``.

    Parameters
    ----------
    scales : callable
        ``scales(height, width)`` returns the scales of a pyramid level of this size, in its own pixels.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.

    Notes
    -----
    A warp leaves uncovered pixels black, and an ``ImageRegistrator`` drops them from the map that an elementwise loss
    returns. Histograms of neighbourhoods have black in them by then. This loss samples a white image at the grid that
    autograd has saved of the warp, and takes the covered pixels alone into the histograms of both images.

    Examples
    --------
    >>> from kornia.geometry import ImageRegistrator
    >>> registrator = ImageRegistrator("translation", loss_fn=RegistrationLoss(), lr=0.01, tolerance=0.0)
    """

    def __init__(
        self,
        scales: Callable[[int, int], ScaleSpace] = ScaleSpace.for_image,
        accuracy: str | float = "exact",
    ) -> None:
        super().__init__()
        self._scales = scales
        self._accuracy = accuracy

    def forward(self, warped: Tensor, target: Tensor, *, reduction: str = "none") -> Tensor:
        """Return one loss for each image of a batch, averaged over the pixels that it covers.

        Parameters
        ----------
        warped : Tensor, shape (B, C, H, W)
            As ``grid_sample`` has returned it, with a graph.
        target : Tensor, shape (B, C, H, W)
        reduction : {"none"}
            As an ``ImageRegistrator`` passes it.

        Returns
        -------
        Tensor, shape (B, 1, 1, 1)
            Broadcasts to the map of losses that an ``ImageRegistrator`` expects.

        Raises
        ------
        ImageError
            If `warped` is not the result of a bilinear ``grid_sample`` with zeros around the image.
        LoiError
            As :func:`loi_torch.kornia.loi_loss`.
        """
        del reduction
        covered = (covered_part(warped) > COVERED).to(warped)
        scales = self._scales(*target.shape[-2:])
        losses = loi_loss(warped, target, scales, self._accuracy, weights=covered, reduction="none")
        one_pixel = 1.0 / covered[0].numel()
        return losses.reshape(-1, 1, 1, 1) / covered.mean(dim=(1, 2, 3), keepdim=True).clamp_min(one_pixel)


def covered_part(warped: Tensor) -> Tensor:
    """Return the fraction of each pixel that a warped image covers, shape (B, 1, H, W)."""
    node: Any = warped.grad_fn
    padding, mode = getattr(node, "_saved_padding_mode", None), getattr(node, "_saved_interpolation_mode", None)
    if (mode, padding) != (BILINEAR, ZEROS):
        msg = "`warped` must be the result of a bilinear grid_sample with zeros around the image, and have a graph"
        raise ImageError(msg)
    with torch.no_grad():
        white = torch.ones_like(node._saved_input[:, :1])
        return functional.grid_sample(white, node._saved_grid, align_corners=node._saved_align_corners)

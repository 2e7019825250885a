"""The loss as a function and a module of two images (B, C, H, W), differentiable with respect to both."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

import loi_torch.loss
from loi_core import ScaleSpace
from loi_core.errors import DerivativeError, ImageError
from loi_core.objectives.loss import Reduction
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.support.keywords import suggest_keywords

__all__ = ["LOILoss", "loi_loss"]


@suggest_keywords
def loi_loss(
    image: Tensor,
    target: Tensor,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    weights: Tensor | None = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
    reduction: Reduction = "mean",
) -> Tensor:
    """Return the locally orderless image loss of two images.

    Parameters
    ----------
    image, target : Tensor, shape (B, C, H, W)
        Either may require gradients.
    weights : Tensor, shape (B, 1, H, W), optional
        Weight of each pixel, such as a mask. They get no gradient.
    scales, accuracy, exposure, colours
        See :func:`loi_torch.loi_loss`.
    reduction : {"mean", "sum", "none"}
        The mean or the sum over the images of a batch, or one value for each image, shape (B,).

    Returns
    -------
    Tensor, shape () or (B,)

    Raises
    ------
    ImageError
        If the images are not two of one shape (B, C, H, W), or the weights not of shape (B, 1, H, W).
    DerivativeError
        If the target requires gradients and its exposure is fitted, for the loss is not symmetric then.
    LoiError
        As :func:`loi_torch.loi_loss`.

    Notes
    -----
    A target that requires gradients doubles the time: the loss is symmetric, and is differentiated with respect to each
    image in turn.
    """
    if image.ndim != 4 or image.shape != target.shape:
        msg = f"`image` and `target` must have one shape (B, C, H, W), got {tuple(image.shape)}, {tuple(target.shape)}"
        raise ImageError(msg)
    if weights is not None:
        if weights.shape != (image.shape[0], 1, *image.shape[2:]):
            msg = f"`weights` must have shape {(image.shape[0], 1, *image.shape[2:])}, got {tuple(weights.shape)}"
            raise ImageError(msg)
        weights = weights[:, 0]
    if target.requires_grad and exposure != "given":
        msg = "the target has no gradient where its exposure is fitted; detach it, or pass exposure='given'"
        raise DerivativeError(msg)
    options: dict[str, Any] = {
        "channel_axis": -3,
        "weights": weights,
        "exposure": exposure,
        "colours": colours,
        "reduction": reduction,
    }
    value = loi_torch.loss.loi_loss(image, target, scales, accuracy, **options)
    if not target.requires_grad:
        return value
    mirrored = loi_torch.loss.loi_loss(target, image, scales, accuracy, **options)
    return value + (mirrored - mirrored.detach())


@suggest_keywords
class LOILoss(nn.Module):
    """The locally orderless image loss as a module, called with two images (B, C, H, W).

    Parameters
    ----------
    scales, accuracy, exposure, colours, reduction
        See :func:`loi_loss`.

    Examples
    --------
    >>> import torch
    >>> criterion = LOILoss(reduction="none")
    >>> tuple(criterion(torch.zeros(2, 3, 32, 48), torch.ones(2, 3, 32, 48)).shape)
    (2,)
    """

    def __init__(
        self,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        exposure: Exposure = "given",
        colours: Colours = "channels",
        reduction: Reduction = "mean",
    ) -> None:
        super().__init__()
        self._options: dict[str, Any] = {
            "scales": scales,
            "accuracy": accuracy,
            "exposure": exposure,
            "colours": colours,
            "reduction": reduction,
        }

    def forward(self, image: Tensor, target: Tensor, weights: Tensor | None = None) -> Tensor:
        """Return the loss; parameters, result and errors as in :func:`loi_loss`."""
        return loi_loss(image, target, weights=weights, **self._options)

    def extra_repr(self) -> str:
        """Return the options that ``print`` shows."""
        return ", ".join(f"{name}={value!r}" for name, value in self._options.items() if value is not None)

"""kornia's ``ImageRegistrator`` with its loss, and with the library's loss over the part that the images share."""

from __future__ import annotations

import numpy as np
import torch
from kornia.geometry import ImageRegistrator
from torch import Tensor

from examples.external.registration import Loss, Settings
from loi_core.support.arrays import Host
from loi_torch import LOILoss

__all__ = ["register"]

COVERED = 0.9  # kornia's threshold for a pixel that both images cover
MIN_COVERAGE = 0.01
TUNED_RATE = 0.01  # of half the side


class _Counting(ImageRegistrator):
    """A registrator that counts the images that it warps."""

    images = 0

    def get_single_level_loss(self, img_src: Tensor, img_dst: Tensor, transform_model: Tensor) -> Tensor:
        self.images += 1
        return super().get_single_level_loss(img_src, img_dst, transform_model)


class _OverCoveredPart(_Counting):
    """A registrator that compares the covered part alone by the library's loss, which needs whole images."""

    def get_single_level_loss(self, img_src: Tensor, img_dst: Tensor, transform_model: Tensor) -> Tensor:
        self.images += 1
        warper = self.warper(*img_dst.shape[-2:])
        with torch.no_grad():
            covered = (warper(torch.ones_like(img_src[:, :1]), transform_model) > COVERED)[:, 0].double()
        coverage = float(covered.mean())
        warped = warper(img_src, transform_model)
        if coverage < MIN_COVERAGE:
            nothing: Tensor = 0.0 * warped.sum()
            return nothing
        loss: Tensor = LOILoss(img_dst, channel_axis=-3)(warped, weights=covered) / coverage
        return loss


def register(moving: Host, target: Host, loss: Loss, settings: Settings) -> tuple[Host, int]:
    """Return the translation, in pixels, that moves an image onto a target, and the number of warped images.

    Parameters
    ----------
    moving, target : array, shape (H, W, 3)
    loss : {"L1", "loi"}
        "L1" is kornia's default.
    settings : {"default", "tuned"}
        "tuned" moves by up to half of the side on each level of the pyramid, a tenth of it by default, and does not
        stop early.
    """
    registrator_class = _Counting if loss == "L1" else _OverCoveredPart
    registrator = registrator_class("translation")
    if settings == "tuned":
        registrator.lr, registrator.tolerance = TUNED_RATE, 0.0
    source, destination = (
        torch.from_numpy(np.moveaxis(image, -1, 0)[None].astype(np.float32)) for image in (moving, target)
    )
    model = registrator.register(source, destination)
    assert isinstance(model, Tensor)
    half = 0.5 * np.array([target.shape[1], target.shape[0]])
    return -half * model.detach().numpy()[0, :2, 2], registrator.images

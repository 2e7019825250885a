"""kornia's ``ImageRegistrator`` with its loss, and with the library's loss over the part that the images share."""

from __future__ import annotations

import itertools

import numpy as np
import torch
from kornia.geometry import ImageRegistrator, pyrdown
from torch import Tensor
from torch.nn.functional import l1_loss

from examples.external.registration import Loss, Settings
from loi_core.support.arrays import Host
from loi_torch.kornia import RegistrationLoss

__all__ = ["register"]

TUNED_RATE = 0.01  # of half the side
SEARCH_SHIFTS = np.arange(-0.75, 0.76, 0.125)  # of the side, along each axis
SEARCH_COVERAGE = 0.2  # smallest share of the area that the images share
SEARCH_HALVINGS = 2  # of the images, for the search
SEARCHED_RATE = 0.003  # of half the side
SEARCHED_LEVELS = 2


class _Counting(ImageRegistrator):
    """A registrator that counts the images that it warps."""

    images = 0
    start: Tensor | None = None  # shift, shape (2,), in units of half the side

    def reset_model(self) -> None:
        """Begin at `start`."""
        super().reset_model()
        if self.start is not None:
            shift = self.model.shift
            assert isinstance(shift, Tensor)
            shift.data.copy_(self.start.reshape(shift.shape))

    def search(self, source: Tensor, target: Tensor) -> Tensor:
        """Return the best of a grid of shifts by the loss of small images, in both directions."""
        for _ in range(SEARCH_HALVINGS):
            source, target = pyrdown(source), pyrdown(target)
        values = {}
        for shift in itertools.product(SEARCH_SHIFTS, repeat=2):
            if np.prod(1.0 - np.abs(shift)) >= SEARCH_COVERAGE:
                column = 2.0 * torch.tensor(shift)[:, None].requires_grad_()  # `RegistrationLoss` needs a graph
                forth = self.get_single_level_loss(source, target, _translation(column))
                back = self.get_single_level_loss(target, source, _translation(-column))
                values[shift] = (forth + back).item()
        return 2.0 * torch.tensor(min(values, key=values.__getitem__))

    def get_single_level_loss(self, img_src: Tensor, img_dst: Tensor, transform_model: Tensor) -> Tensor:
        self.images += 1
        return super().get_single_level_loss(img_src, img_dst, transform_model)


def _translation(column: Tensor) -> Tensor:
    """Return the homography of a shift, shape (2, 1): (1, 3, 3), float32."""
    matrix = torch.eye(3)[None].clone()
    matrix[0, :2, 2:] = column
    return matrix


def register(moving: Host, target: Host, loss: Loss, settings: Settings) -> tuple[Host, int]:
    """Return the translation, in pixels, that moves an image onto a target, and the number of warped images.

    Parameters
    ----------
    moving, target : array, shape (H, W, 3)
    loss : {"L1", "loi"}
        "L1" is kornia's default.
    settings : {"default", "tuned", "searched"}
        "tuned" moves by up to half of the side on each level of the pyramid, a tenth of it by default, and does not
        stop early. "searched" begins at the best of a grid of shifts, by the loss of images of a quarter of the size,
        and descends on two levels.
    """
    registrator = _Counting("translation", loss_fn=l1_loss if loss == "L1" else RegistrationLoss())
    if settings == "tuned":
        registrator.lr, registrator.tolerance = TUNED_RATE, 0.0
    source, destination = (
        torch.from_numpy(np.moveaxis(image, -1, 0)[None].astype(np.float32)) for image in (moving, target)
    )
    if settings == "searched":
        registrator.start = registrator.search(source, destination)
        registrator.lr, registrator.tolerance, registrator.pyramid_levels = SEARCHED_RATE, 0.0, SEARCHED_LEVELS
    model = registrator.register(source, destination)
    assert isinstance(model, Tensor)
    half = 0.5 * np.array([target.shape[1], target.shape[0]])
    return -half * model.detach().numpy()[0, :2, 2], registrator.images

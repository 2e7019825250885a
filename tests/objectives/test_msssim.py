"""MS-SSIM equals the implementation of pytorch-msssim, and has a gradient of 0 where its value is constant."""

from __future__ import annotations

import numpy as np
import pytest

from loi_core import MSSSIM
from loi_core.errors import ImageError, OptionError
from loi_core.testing import check_objective
from tests.contents import CONTENTS
from tests.frameworks import pytorch_msssim, torch
from tests.helpers import Host

SIZES = [(256, 192), (177, 201), (180, 333)]  # even, odd at several levels
PEER_RTOL = 1e-4  # pytorch-msssim rounds its window to float32; cancellation magnifies the error


def peer_value_and_grad(image: Host, reference: Host, levels: int) -> tuple[float, Host]:
    leaf, target = (torch.tensor(np.moveaxis(array, -1, 0)[None].copy()) for array in (image, reference))
    leaf.requires_grad_()
    compare = pytorch_msssim.ms_ssim if levels > 1 else pytorch_msssim.ssim
    loss = 1.0 - compare(leaf, target, data_range=1.0)
    loss.backward()
    assert leaf.grad is not None
    return float(loss.detach()), np.moveaxis(leaf.grad.numpy()[0], 0, -1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("levels", [1, 5])
@pytest.mark.parametrize("content", ["shifted", "photographs"])
def test_value_and_gradient_equal_pytorch_msssim(size: tuple[int, int], levels: int, content: str) -> None:
    image, reference = CONTENTS[content]((*size, 3), np.random.default_rng(1))
    value, gradient = MSSSIM(reference, levels).value_and_grad(image)
    expected, slopes = peer_value_and_grad(image, reference, levels)
    assert float(value) == pytest.approx(expected, rel=PEER_RTOL)
    assert np.linalg.norm(gradient - slopes) <= PEER_RTOL * np.linalg.norm(slopes)


def test_ms_ssim_keeps_the_contract_of_objectives() -> None:
    check_objective(lambda reference: MSSSIM(reference), shape=(24, 31, 2))


def test_ms_ssim_uses_as_many_levels_as_fit_by_default() -> None:
    for size, levels in ((11, 1), (21, 1), (22, 2), (128, 4), (175, 4), (176, 5), (400, 5)):
        image, reference = np.random.default_rng(0).uniform(size=(2, size, size, 1))
        assert float(MSSSIM(reference).value(image)) == float(MSSSIM(reference, levels).value(image))
        with pytest.raises(OptionError, match=f"from 1 to {levels} "):
            MSSSIM(reference, levels + 1)


def test_images_of_opposite_structure_have_the_largest_value_and_no_gradient() -> None:
    stripes = np.tile(np.where(np.arange(32) % 2 == 0, 0.2, 0.8)[None, :, None], (32, 1, 1))
    value, gradient = MSSSIM(stripes, 1).value_and_grad(1.0 - stripes)
    assert float(value) == 1.0
    assert not np.any(gradient)


def test_ms_ssim_refuses_small_images_and_an_empty_range() -> None:
    with pytest.raises(ImageError, match="at least 11 rows and columns"):
        MSSSIM(np.zeros((10, 40, 3)))
    with pytest.raises(OptionError, match="`data_range` must be"):
        MSSSIM(np.zeros((40, 40, 3)), data_range=0.0)

"""Tests of colour differences in the losses of all adapters."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from hypothesis import given

import loi_jax
import loi_mitsuba
import loi_torch
from loi_core import LOIObjective, ScaleSpace
from tests.helpers import Host
from tests.strategies import FEWER_EXAMPLES, SEEDS

# isort: split
import drjit as dr
import mitsuba as mi

# The images have intensities outside the bounds, and the core warns of them.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

SCALES = ScaleSpace((0, 1), (1, 5), 0.125)


def images(seed: int) -> tuple[Host, Host]:
    first, second = np.random.default_rng(seed).uniform(-0.2, 1.2, (2, 9, 12, 3)).astype(np.float32)
    return first, second


@given(SEEDS)
@FEWER_EXAMPLES
def test_losses_of_colour_differences_are_equal_in_every_adapter(seed: int) -> None:
    mi.set_variant("llvm_ad_rgb")
    image, reference = images(seed)
    value, gradient = LOIObjective(reference, SCALES, colours="differences").value_and_grad(image)

    leaf: Any = torch.tensor(image, requires_grad=True)
    torch_loss: Any = loi_torch.loi_loss(leaf, reference, SCALES, colours="differences")
    torch_loss.backward()
    jax_loss, jax_gradient = jax.value_and_grad(partial(loi_jax.loi_loss, scales=SCALES, colours="differences"))(
        jnp.asarray(image), reference
    )
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    mitsuba_loss = loi_mitsuba.loi_loss(tensor, reference, SCALES, colours="differences")
    dr.backward(mitsuba_loss)

    for adapter_value, slopes in (
        (float(torch_loss.detach()), leaf.grad.numpy()),
        (float(jax_loss), np.asarray(jax_gradient)),
        (float(mitsuba_loss.numpy()[0]), dr.grad(tensor).numpy()),
    ):
        assert adapter_value == pytest.approx(float(value), rel=1e-5)
        np.testing.assert_allclose(slopes, gradient, atol=1e-4 * float(np.abs(gradient).max()))


def test_the_torch_module_prints_its_colours_option() -> None:
    assert "colours='differences'" in repr(loi_torch.LOILoss(SCALES, colours="differences"))
    assert "colours" not in repr(loi_torch.LOILoss(SCALES))

"""Differences of colours are compared in the same way by the losses of all adapters."""

from __future__ import annotations

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

# What lies beyond the bounds is met here, and is no point of these tests.
pytestmark = pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning")

SCALES = ScaleSpace((0, 1), (1, 5), 0.125)


def images(seed: int) -> tuple[Host, Host]:
    first, second = np.random.default_rng(seed).uniform(-0.2, 1.2, (2, 9, 12, 3)).astype(np.float32)
    return first, second


@given(SEEDS)
@FEWER_EXAMPLES
def test_every_adapter_compares_the_same(seed: int) -> None:
    mi.set_variant("llvm_ad_rgb")
    image, reference = images(seed)
    value, gradient = LOIObjective(reference, SCALES, colours="differences").value_and_grad(image)

    leaf: Any = torch.tensor(image, requires_grad=True)
    by_torch = loi_torch.loi_loss(reference, SCALES, colours="differences")(leaf)
    by_torch.backward()
    by_jax = jax.value_and_grad(loi_jax.loi_loss(reference, SCALES, colours="differences"))(jnp.asarray(image))
    tensor = mi.TensorXf(image)
    dr.enable_grad(tensor)
    by_mitsuba = loi_mitsuba.LOILoss(reference, SCALES, colours="differences")(tensor)
    dr.backward(by_mitsuba)

    for other, slopes in (
        (float(by_torch.detach()), leaf.grad.numpy()),
        (float(by_jax[0]), np.asarray(by_jax[1])),
        (float(by_mitsuba.numpy()[0]), dr.grad(tensor).numpy()),
    ):
        assert other == pytest.approx(float(value), rel=1e-5)
        np.testing.assert_allclose(slopes, gradient, atol=1e-4 * float(np.abs(gradient).max()))


def test_the_module_of_torch_tells_of_them() -> None:
    assert "colours='differences'" in repr(loi_torch.LOILoss(images(0)[1], SCALES, colours="differences"))
    assert "colours" not in repr(loi_torch.LOILoss(images(0)[1], SCALES))

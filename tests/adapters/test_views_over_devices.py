"""Test of views on several JAX devices: their mean loss and gradient equal the results of one device."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.environments import ROOT
from tests.helpers import without_numba

SHARDED = """
import os
os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=4"
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
import loi_jax
from loi_core import LOIObjective, ScaleSpace
jax.config.update("jax_enable_x64", True)
scales = ScaleSpace(1, 3, 0.25)
views, devices = 6, 4
rng = np.random.default_rng(0)
photographs, patterns = rng.uniform(size=(2, views, 16, 12, 3))
offset = jnp.array([0.3, -0.2, 0.1])
render = jax.vmap(lambda offset, pattern: jax.nn.sigmoid(pattern + offset), (None, 0))
def compiled(factor=1.0, **options):
    def loss(offset, patterns, photographs):
        return factor * loi_jax.loi_loss(render(offset, patterns), photographs, scales, **options)
    return jax.jit(jax.value_and_grad(loss))
step = compiled()
expected = step(offset, patterns, photographs)
assert expected[0].devices() == {jax.devices()[0]}
images = np.asarray(render(offset, patterns))
values = [LOIObjective(photograph, scales).value(image) for photograph, image in zip(photographs, images)]
np.testing.assert_allclose(expected[0], np.mean(values), rtol=1e-11)
def check(results):
    for result, number in zip(results, expected, strict=True):
        np.testing.assert_allclose(result, number, rtol=1e-11)
def sharded(patterns, devices, kind=AxisType.Auto):
    mesh = jax.make_mesh((devices,), ("views",), axis_types=(kind,), devices=jax.devices()[:devices])
    shards = jax.device_put(patterns, NamedSharding(mesh, PartitionSpec("views")))
    assert len(shards.devices()) == devices
    return shards
for kind in (AxisType.Auto, AxisType.Explicit):
    check(step(offset, sharded(patterns, 3, kind), sharded(photographs, 3, kind)))
text = step.lower(offset, sharded(patterns, 3), sharded(photographs, 3)).compile().as_text()
assert "all-reduce" in text and "all-gather" not in text and "callback" not in text
# Views of weight 0 pad the batch to a multiple of the number of devices.
extra = -views % devices
photographs, patterns = (np.concatenate([array, array[:extra]]) for array in (photographs, patterns))
weights = np.ones((views + extra, 16, 12))
weights[views:] = 0.0
padded = compiled((views + extra) / views, weights=weights)
check(padded(offset, sharded(patterns, devices), sharded(photographs, devices)))
# Each of two devices has a separate program for its views, and their weighted results are added.
value, slope = 0.0, 0.0
for device, subset in zip(jax.devices(), (slice(0, 4), slice(4, 6))):
    partial = compiled((subset.stop - subset.start) / views)
    results = partial(*jax.device_put((offset, patterns[subset], photographs[subset]), device))
    assert results[1].devices() == {device}
    partial_value, partial_slope = jax.device_put(results, jax.devices()[0])
    value, slope = value + partial_value, slope + partial_slope
check((value, slope))
print("done")
"""


def test_views_on_several_jax_devices_have_the_loss_and_gradient_of_one_device() -> None:
    pytest.importorskip("jax")
    command = [sys.executable, "-W", "ignore", "-c", SHARDED]
    with without_numba():
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr

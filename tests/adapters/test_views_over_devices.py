"""Views over devices of JAX have the same mean and gradient as on one device."""

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
place = jnp.array([0.3, -0.2, 0.1])
render = jax.vmap(lambda place, pattern: jax.nn.sigmoid(pattern + place), (None, 0))
def total(loss, factor=1.0):
    return jax.jit(jax.value_and_grad(lambda place, patterns: factor * loss(render(place, patterns))))
step = total(loi_jax.loi_loss(photographs, scales))
wanted = step(place, patterns)
assert wanted[0].devices() == {jax.devices()[0]}
images = np.asarray(render(place, patterns))
each = [LOIObjective(photograph, scales).value(image) for photograph, image in zip(photographs, images)]
np.testing.assert_allclose(wanted[0], np.mean(each), rtol=1e-11)
def agrees(found):
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11)
def spread(patterns, devices, kind=AxisType.Auto):
    mesh = jax.make_mesh((devices,), ("views",), axis_types=(kind,), devices=jax.devices()[:devices])
    made = jax.device_put(patterns, NamedSharding(mesh, PartitionSpec("views")))
    assert len(made.devices()) == devices
    return made
for kind in (AxisType.Auto, AxisType.Explicit):
    agrees(step(place, spread(patterns, 3, kind)))
text = step.lower(place, spread(patterns, 3)).compile().as_text()
assert "all-reduce" in text and "all-gather" not in text and "callback" not in text
# Views that count nothing make up a number that the devices divide.
extra = -views % devices
photographs, patterns = (np.concatenate([each, each[:extra]]) for each in (photographs, patterns))
counts = np.ones((views + extra, 16, 12))
counts[views:] = 0.0
padded = total(loi_jax.loi_loss(photographs, scales, weights=counts), (views + extra) / views)
agrees(padded(place, spread(patterns, devices)))
# Or each device has views, and a program, of its own: as many as there are.
value, slope = 0.0, 0.0
for here, own in zip(jax.devices(), (slice(0, 4), slice(4, 6))):
    share = total(loi_jax.loi_loss(photographs[own], scales), (own.stop - own.start) / views)
    part, push = share(*jax.device_put((place, patterns[own]), here))
    assert push.devices() == {here}
    part, push = jax.device_put((part, push), jax.devices()[0])
    value, slope = value + part, slope + push
agrees((value, slope))
print("done")
"""


def test_a_batch_of_views_over_devices_of_jax_has_the_loss_and_gradient_of_one_device() -> None:
    pytest.importorskip("jax")
    command = [sys.executable, "-W", "ignore", "-c", SHARDED]
    with without_numba():
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr

"""On the processor JAX's programs call the compiled kernels: the same bits, no waiting for each other, nothing lost."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loi_jax
from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.method import compiled
from loi_core.pixels.nonfinite import NanPolicy
from tests.conformance.test_backends import TONES
from tests.helpers import images, without_numba
from tests.strategies import FEWER_EXAMPLES, Problem, problems, thorough

pytestmark = [
    pytest.mark.skipif(not compiled.available(), reason="needs Numba"),
    # Problems are drawn with values beyond the bounds as well.
    pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning"),
]

SCALES = ScaleSpace(1, (1, 5), 0.25)
IMAGE, REFERENCE = images((9, 7, 2), seed=1)


def both(**settings: Any) -> Any:
    """A new function each time, which JAX has not compiled before."""
    return jax.value_and_grad(loi_jax.loi_loss(REFERENCE, SCALES, **settings))


def lowered(function: Any, *platforms: str) -> str:
    traced = jax.jit(function).trace(jnp.asarray(IMAGE))
    text: str = traced.lower(lowering_platforms=platforms or None).as_text()
    return text


@FEWER_EXAMPLES
@given(problems(), st.sampled_from(TONES), st.sampled_from(["raise", "mask"]), st.sampled_from(["exact", "balanced"]))
def test_every_transformation_gives_the_bits_of_numpy(
    problem: Problem, tone: LogTone | None, policy: NanPolicy, accuracy: str
) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    if policy == "mask":
        image[..., 0, 0, :] = np.nan
    value, gradient = LOIObjective(reference, scales, accuracy, nan_policy=policy, tone=tone).value_and_grad(image)
    loss = loi_jax.loi_loss(reference, scales, accuracy, nan_policy=policy, tone=tone)
    given, twice = jnp.asarray(image), jnp.stack([jnp.asarray(image)] * 2)
    pair = jax.value_and_grad(loss)
    found = {
        "eager": pair(given),
        "jit": jax.jit(pair)(given),
        "vmap": jax.tree.map(lambda both: both[1], jax.vmap(pair)(twice)),
        "jit of vmap": jax.tree.map(lambda both: both[1], jax.jit(jax.vmap(pair))(twice)),
        "scan": jax.tree.map(lambda both: both[1], jax.jit(lambda x: jax.lax.map(pair, x))(twice)),
    }
    for name, (ours, slopes) in found.items():
        assert ours.dtype == slopes.dtype == dtype, name
        assert ours == value, name
        np.testing.assert_array_equal(slopes, gradient, err_msg=name)
    assert jax.jit(loss)(given) == loss(given) == value


def test_axes_of_vmap_may_be_anywhere() -> None:
    batch = jnp.asarray(np.random.default_rng(0).uniform(size=(9, 3, 7, 2, 2)))
    pair = jax.vmap(jax.vmap(both(), in_axes=-1, out_axes=(0, 2)), in_axes=1, out_axes=(1, 0))
    for values, gradients in (pair(batch), jax.jit(pair)(batch)):
        assert values.shape == (2, 3)
        assert gradients.shape == (3, 9, 7, 2, 2)
        value, gradient = LOIObjective(REFERENCE, SCALES).value_and_grad(np.asarray(batch[:, 2, :, :, 1]))
        assert values[1, 2] == value
        np.testing.assert_array_equal(gradients[2, :, :, 1, :], gradient)


def test_of_a_batch_only_the_image_that_is_not_finite_has_a_loss_of_nan() -> None:
    batch = jnp.stack([jnp.asarray(IMAGE)] * 3).at[1, 0, 0, 0].set(jnp.inf)
    wanted = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)[1]
    pair = jax.vmap(both())
    for values, gradients in (pair(batch), jax.jit(pair)(batch)):
        assert np.isnan(values).tolist() == [False, True, False]
        assert np.all(np.isnan(gradients[1]))
        np.testing.assert_array_equal(gradients[2], wanted)


def test_only_what_runs_on_one_processor_calls_back() -> None:
    assert "callback" in lowered(both())
    for platforms in (("cuda",), ("tpu",), ("cpu", "cuda")):
        assert "callback" not in lowered(both(), *platforms), platforms
    assert "callback" not in jax.export.export(jax.jit(both()))(jnp.asarray(IMAGE)).mlir_module()


def test_what_jax_compiles_does_not_grow_with_the_image() -> None:
    large = np.zeros((512, 512, 3))
    traced = jax.jit(jax.value_and_grad(loi_jax.loi_loss(large, SCALES))).trace(jnp.asarray(large))
    assert len(traced.lower().as_text()) < 2 * len(lowered(both()))


def test_second_derivatives_are_those_of_operations_on_arrays() -> None:
    def slope(x: Any) -> Any:
        return jnp.sum(both()(x)[1] ** 2)

    ours = jax.jit(jax.grad(slope))(jnp.asarray(IMAGE))
    with without_numba():
        theirs = jax.jit(jax.grad(lambda x: slope(x)))(jnp.asarray(IMAGE))
    assert np.any(theirs)
    np.testing.assert_array_equal(ours, theirs)


def test_what_fails_is_raised_and_nothing_is_lost() -> None:
    pair, image = jax.jit(both()), jnp.asarray(IMAGE)
    before = pair(image)[0]
    with pytest.MonkeyPatch.context() as patch:

        def full(*_: Any) -> None:
            msg = "full"
            raise MemoryError(msg)

        patch.setattr(LOIObjective, "value_and_grad", full)
        for _ in range(20):
            with pytest.raises((jax.errors.JaxRuntimeError, ValueError), match="MemoryError: full"):
                pair(image)[0].block_until_ready()
    assert pair(image)[0] == before


def run(script: str, *, devices: int = 1) -> str:
    """What `script` prints, in a process of its own, which does not have 64 bits switched on."""
    flags = f"import os; os.environ['XLA_FLAGS'] = '--xla_force_host_platform_device_count={devices}'\n"
    command = [sys.executable, "-W", "ignore", "-c", flags + script]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=True).stdout.strip()


MANY = """
import os, sys, threading
if {alone} and hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])
import jax, jax.numpy as jnp, numpy as np
import loi_jax
from loi_core import LOIObjective, ScaleSpace
scales = ScaleSpace(1, (1, 5), 0.25)
size, calls = {size}, {calls}
image, reference = np.random.default_rng(0).uniform(size=(2, size, size, 3))
image[24:] = reference[24:]  # which costs next to nothing to compare
value, gradient = LOIObjective(reference, scales).value_and_grad(image)
loss = loi_jax.loi_loss(reference, scales)
def work():
    with jax.enable_x64(True):
        given = jnp.asarray(image)
        pair = jax.jit(lambda x: jax.value_and_grad(loss)(1.0 * x))
        step = jax.jit(lambda x: x - 1e-3 * jax.grad(loss)(x))
        many = [pair(given) for _ in range(calls)]
        moved = given
        for _ in range(calls):
            moved = step(moved)
        assert all(ours.dtype == np.float64 and ours == value for ours, _ in many)
        np.testing.assert_array_equal(many[-1][1], gradient)
        assert pair(moved)[0] == LOIObjective(reference, scales).value(np.asarray(moved))
        return [step(moved) for _ in range(calls)]  # nobody waits for them
failed = []
threading.excepthook = failed.append
workers = [threading.Thread(target=work) for _ in range(2)]
for worker in workers: worker.start()
left = work()
for worker in workers: worker.join()
assert not failed, failed
print("done")
"""


# JAX computes small things in the thread that calls, and large ones in threads of its own; where only a context has
# 64 bits, those do not know.
@pytest.mark.parametrize(("size", "calls"), [(48, 60), pytest.param(1024, 2, marks=thorough)], ids=["small", "large"])
@pytest.mark.parametrize("alone", [True, False], ids=["one core", "all cores"])
def test_many_calls_that_nobody_waits_for_end_and_keep_all_bits(alone: bool, size: int, calls: int) -> None:
    assert run(MANY.format(alone=alone, size=size, calls=calls)) == "done"


SEVERAL = """
import jax, jax.numpy as jnp, numpy as np
import loi_jax
from jax.sharding import NamedSharding, PartitionSpec as P
from loi_core import LOIObjective, ScaleSpace
scales = ScaleSpace(1, 5, 0.25)
images = np.random.default_rng(0).uniform(size=(5, 8, 7, 3)).astype(np.float32)
reference, batch = images[0], images[1:]
wanted = [LOIObjective(reference, scales).value_and_grad(image)[1] for image in batch]
loss = loi_jax.loi_loss(reference, scales)
each = jax.vmap(jax.grad(loss))
mesh = jax.make_mesh((2,), ("b",), axis_types=(jax.sharding.AxisType.Auto,))
parts = jax.device_put(batch, NamedSharding(mesh, P("b")))
spread = jax.jit(each)(parts)
assert spread.sharding.spec == P("b")
at_once = each(parts)
mapped = jax.jit(jax.shard_map(each, mesh=mesh, in_specs=P("b"), out_specs=P("b")))(batch)
second = jax.jit(each)(jax.device_put(batch, jax.devices()[1]))
eager = each(jax.device_put(batch, jax.devices()[1]))
assert second.devices() == eager.devices() == {jax.devices()[1]}
for found in (spread, at_once, mapped, second, eager):
    np.testing.assert_allclose(found, wanted, rtol=1e-2, atol=1e-6)
rows = jax.device_put(batch[0], NamedSharding(mesh, P("b")))
for found in (jax.grad(loss)(rows), LOIObjective(reference, scales).value_and_grad(rows)[1]):
    np.testing.assert_allclose(found, wanted[0], rtol=1e-2, atol=1e-6)
print("done")
"""


def test_several_devices_compute_their_parts() -> None:
    assert run(SEVERAL, devices=2) == "done"

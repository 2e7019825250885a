"""Tests of compiled kernels in JAX programs on a CPU: equal bits, no deadlocks, and errors that reach the caller."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
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
from loi_core.objectives.loss import LossSettings
from loi_core.pixels.nonfinite import NanPolicy
from tests.conformance.test_backends import TONES
from tests.helpers import images, without_numba
from tests.strategies import FEWER_EXAMPLES, Problem, problems, thorough

pytestmark = [
    pytest.mark.skipif(not compiled.available(), reason="needs Numba"),
    # Some problems have intensities outside the bounds, and the core warns of them.
    pytest.mark.filterwarnings("ignore::loi_core.objectives.RangeWarning"),
]

SCALES = ScaleSpace(1, (1, 5), 0.25)
IMAGE, REFERENCE = images((9, 7, 2), seed=1)


def value_and_grad(**settings: Any) -> Any:
    """Return the loss's value and gradient as a new function, which JAX has not compiled before."""
    return jax.value_and_grad(partial(loi_jax.loi_loss, target=REFERENCE, scales=SCALES, **settings))


def lowered(function: Any, *platforms: str) -> str:
    """Return the program of a function of an image for some platforms, by default the current platform."""
    traced = jax.jit(function).trace(jnp.asarray(IMAGE))
    text: str = traced.lower(lowering_platforms=platforms or None).as_text()
    return text


@FEWER_EXAMPLES
@given(problems(), st.sampled_from(TONES), st.sampled_from(["raise", "mask"]), st.sampled_from(["exact", "balanced"]))
def test_every_jax_transformation_gives_the_bits_of_numpy(
    problem: Problem, tone: LogTone | None, policy: NanPolicy, accuracy: str
) -> None:
    image, reference, scales, dtype = problem
    image, reference = image.astype(dtype), reference.astype(dtype)
    if policy == "mask":
        image[..., 0, 0, :] = np.nan
    value, gradient = LOIObjective(reference, scales, accuracy, nan_policy=policy, tone=tone).value_and_grad(image)
    options: dict[str, Any] = {"nan_policy": policy, "tone": tone}
    loss: Any = partial(loi_jax.loi_loss, target=reference, scales=scales, accuracy=accuracy, **options)
    pixels, batch = jnp.asarray(image), jnp.stack([jnp.asarray(image)] * 2)
    pair = jax.value_and_grad(loss)
    results = {
        "eager": pair(pixels),
        "jit": jax.jit(pair)(pixels),
        "vmap": jax.tree.map(lambda values: values[1], jax.vmap(pair)(batch)),
        "jit of vmap": jax.tree.map(lambda values: values[1], jax.jit(jax.vmap(pair))(batch)),
        "scan": jax.tree.map(lambda values: values[1], jax.jit(lambda x: jax.lax.map(pair, x))(batch)),
    }
    for name, (jax_value, slopes) in results.items():
        assert jax_value.dtype == slopes.dtype == dtype, name
        assert jax_value == value, name
        np.testing.assert_array_equal(slopes, gradient, err_msg=name)
    assert jax.jit(loss)(pixels) == loss(pixels) == value


def test_vmap_of_the_jax_loss_accepts_any_input_and_output_axes() -> None:
    batch = jnp.asarray(np.random.default_rng(0).uniform(size=(9, 3, 7, 2, 2)))
    pair = jax.vmap(jax.vmap(value_and_grad(), in_axes=-1, out_axes=(0, 2)), in_axes=1, out_axes=(1, 0))
    for values, gradients in (pair(batch), jax.jit(pair)(batch)):
        assert values.shape == (2, 3)
        assert gradients.shape == (3, 9, 7, 2, 2)
        value, gradient = LOIObjective(REFERENCE, SCALES).value_and_grad(np.asarray(batch[:, 2, :, :, 1]))
        assert values[1, 2] == value
        np.testing.assert_array_equal(gradients[2, :, :, 1, :], gradient)


def test_only_the_image_with_an_infinite_pixel_has_a_loss_of_nan_in_a_batch() -> None:
    batch = jnp.stack([jnp.asarray(IMAGE)] * 3).at[1, 0, 0, 0].set(jnp.inf)
    expected = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)[1]
    pair = jax.vmap(value_and_grad())
    for values, gradients in (pair(batch), jax.jit(pair)(batch)):
        assert np.isnan(values).tolist() == [False, True, False]
        assert np.all(np.isnan(gradients[1]))
        np.testing.assert_array_equal(gradients[2], expected)


def test_only_jax_programs_for_the_cpu_alone_call_the_kernels() -> None:
    assert "callback" in lowered(value_and_grad())
    for platforms in (("cuda",), ("tpu",), ("cpu", "cuda")):
        assert "callback" not in lowered(value_and_grad(), *platforms), platforms
    assert "callback" not in jax.export.export(jax.jit(value_and_grad()))(jnp.asarray(IMAGE)).mlir_module()


def test_the_jax_program_does_not_grow_with_the_image() -> None:
    large = np.zeros((512, 512, 3))
    traced = jax.jit(jax.value_and_grad(partial(loi_jax.loi_loss, scales=SCALES))).trace(large, large)
    assert len(traced.lower().as_text()) < 2 * len(lowered(value_and_grad()))


def test_second_derivatives_in_jax_equal_second_derivatives_without_kernels() -> None:
    def slope(x: Any) -> Any:
        return jnp.sum(value_and_grad()(x)[1] ** 2)

    with_kernels = jax.jit(jax.grad(slope))(jnp.asarray(IMAGE))
    with without_numba():
        without_kernels = jax.jit(jax.grad(lambda x: slope(x)))(jnp.asarray(IMAGE))
    assert np.any(without_kernels)
    np.testing.assert_array_equal(with_kernels, without_kernels)


def test_errors_of_the_kernels_reach_the_caller_and_later_calls_succeed() -> None:
    pair, image = jax.jit(value_and_grad()), jnp.asarray(IMAGE)
    expected = pair(image)[0]
    with pytest.MonkeyPatch.context() as patch:

        def raise_memory_error(*_: Any, **__: Any) -> None:
            msg = "full"
            raise MemoryError(msg)

        patch.setattr(LossSettings, "evaluate", raise_memory_error)
        for _ in range(20):
            with pytest.raises((jax.errors.JaxRuntimeError, ValueError), match="MemoryError: full"):
                pair(image)[0].block_until_ready()
    assert pair(image)[0] == expected


def run(script: str, *, devices: int = 1) -> str:
    """Return the output of a script in a separate process, without JAX's 64-bit mode."""
    flags = f"import os; os.environ['XLA_FLAGS'] = '--xla_force_host_platform_device_count={devices}'\n"
    command = [sys.executable, "-W", "ignore", "-c", flags + script]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=True).stdout.strip()


CONCURRENT_CALLS = """
import os, sys, threading
if {one_core} and hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])
import jax, jax.numpy as jnp, numpy as np
import loi_jax
from loi_core import LOIObjective, ScaleSpace
scales = ScaleSpace(1, (1, 5), 0.25)
size, calls = {size}, {calls}
image, reference = np.random.default_rng(0).uniform(size=(2, size, size, 3))
image[24:] = reference[24:]  # equal rows cost almost no time
value, gradient = LOIObjective(reference, scales).value_and_grad(image)
loss = lambda image: loi_jax.loi_loss(image, reference, scales)
def work():
    with jax.enable_x64(True):
        start = jnp.asarray(image)
        pair = jax.jit(lambda x: jax.value_and_grad(loss)(1.0 * x))
        step = jax.jit(lambda x: x - 1e-3 * jax.grad(loss)(x))
        results = [pair(start) for _ in range(calls)]
        moved = start
        for _ in range(calls):
            moved = step(moved)
        assert all(result.dtype == np.float64 and result == value for result, _ in results)
        np.testing.assert_array_equal(results[-1][1], gradient)
        assert pair(moved)[0] == LOIObjective(reference, scales).value(np.asarray(moved))
        return [step(moved) for _ in range(calls)]  # unfinished when the thread ends
failures = []
threading.excepthook = failures.append
workers = [threading.Thread(target=work) for _ in range(2)]
for worker in workers: worker.start()
unfinished = work()
for worker in workers: worker.join()
assert not failures, failures
print("done")
"""


# JAX computes small arrays in the calling thread and large arrays in its worker threads. The context `enable_x64`
# does not apply in the worker threads.
@pytest.mark.parametrize(("size", "calls"), [(48, 60), pytest.param(1024, 2, marks=thorough)], ids=["small", "large"])
@pytest.mark.parametrize("one_core", [True, False], ids=["one core", "all cores"])
def test_concurrent_asynchronous_jax_calls_finish_with_exact_results(one_core: bool, size: int, calls: int) -> None:
    assert run(CONCURRENT_CALLS.format(one_core=one_core, size=size, calls=calls)) == "done"


TWO_DEVICES = """
import jax, jax.numpy as jnp, numpy as np
import loi_jax
from jax.sharding import NamedSharding, PartitionSpec as P
from loi_core import LOIObjective, ScaleSpace
scales = ScaleSpace(1, 5, 0.25)
images = np.random.default_rng(0).uniform(size=(5, 8, 7, 3)).astype(np.float32)
reference, batch = images[0], images[1:]
expected = [LOIObjective(reference, scales).value_and_grad(image)[1] for image in batch]
loss = lambda image: loi_jax.loi_loss(image, reference, scales)
gradients = jax.vmap(jax.grad(loss))
mesh = jax.make_mesh((2,), ("b",), axis_types=(jax.sharding.AxisType.Auto,))
shards = jax.device_put(batch, NamedSharding(mesh, P("b")))
sharded = jax.jit(gradients)(shards)
assert sharded.sharding.spec == P("b")
eager_sharded = gradients(shards)
mapped = jax.jit(jax.shard_map(gradients, mesh=mesh, in_specs=P("b"), out_specs=P("b")))(batch)
second = jax.jit(gradients)(jax.device_put(batch, jax.devices()[1]))
eager = gradients(jax.device_put(batch, jax.devices()[1]))
assert second.devices() == eager.devices() == {jax.devices()[1]}
for result in (sharded, eager_sharded, mapped, second, eager):
    np.testing.assert_allclose(result, expected, rtol=1e-2, atol=1e-6)
rows = jax.device_put(batch[0], NamedSharding(mesh, P("b")))
for result in (jax.grad(loss)(rows), LOIObjective(reference, scales).value_and_grad(rows)[1]):
    np.testing.assert_allclose(result, expected[0], rtol=1e-2, atol=1e-6)
print("done")
"""


def test_jax_devices_compute_the_gradients_of_their_shards() -> None:
    assert run(TWO_DEVICES, devices=2) == "done"

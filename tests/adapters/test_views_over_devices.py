"""Views over processes and devices: the same mean and the same gradient as in one place."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from loi_core.errors import DistributedError, OptionError
from tests.environments import ROOT
from tests.frameworks import torch
from tests.helpers import by_arrays

RANKS = 3


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What each of three processes says, the last of which leaves the others waiting and then dies."""
    pytest.importorskip("torch")
    command = [sys.executable, "-W", "ignore", "-m", "tests.adapters.ranks"]
    file = tmp_path_factory.mktemp("ranks") / "meeting"
    with by_arrays():
        ranks = [
            subprocess.Popen([*command, str(rank), str(RANKS), file], stdout=subprocess.PIPE, cwd=ROOT, text=True)
            for rank in range(RANKS)
        ]
        try:
            said = [process.communicate(timeout=240)[0] for process in ranks]
        finally:
            for process in ranks:
                process.kill()
    assert [process.returncode for process in ranks] == [0, 0, 1]
    return [json.loads(each) for each in said]


def numbers(bits: list[str]) -> Any:
    return np.array([float.fromhex(one) for one in bits], dtype=np.float32)


def test_ranks_with_few_many_or_no_views_have_the_mean_and_gradient_of_one_process(found: list[dict[str, Any]]) -> None:
    from tests.adapters import ranks

    with by_arrays():
        shared = ranks.parameters()
        losses = ranks.losses_of(range(len(ranks.SIZES)), shared)
        losses.mean().backward()  # type: ignore[no-untyped-call]
    wanted = torch.cat([one.grad for one in shared]).numpy()
    # What is added is as large as the largest part, of which each sum of 5 views is off by a rounding or two.
    rounding = 4 * len(ranks.SIZES) * float(np.finfo(np.float32).eps) * float(np.abs(wanted).max())
    seen = 0
    for one in found:
        for name, each in one.items():
            if "gradient" in each:
                seen += 1
                # However views are divided, to the bit: they are added in one order.
                assert numbers(each["value"]) == losses.detach().double().mean().float().item(), name
                np.testing.assert_allclose(numbers(each["gradient"]), wanted, rtol=0.0, atol=rounding, err_msg=name)
    assert seen == 2 * 2 + 3 * 3  # by rank: of two, once and by DistributedDataParallel; of three, and once without


def test_all_ranks_hold_the_same_bits(found: list[dict[str, Any]]) -> None:
    for name, each in found[0].items():
        if "gradient" in each:
            assert all(one[name] == each for one in found if name in one), name


def test_what_is_wrong_on_all_ranks_is_told_on_all(found: list[dict[str, Any]]) -> None:
    for one in found:
        assert one["no view"]["kind"] == "OptionError"
        assert one["other sizes"]["says"].startswith("`parameters` must be the same on all ranks, got [2, 3, 4]")


def test_a_rank_that_is_late_or_dies_leaves_nobody_waiting(found: list[dict[str, Any]]) -> None:
    for rank, one in enumerate(found[:-1]):
        assert one["slow"]["kind"] == one["dead"]["kind"] == "DistributedError"
        assert one["slow"]["says"].startswith(f"rank {rank} of 3 waited in mean_over_views for others in vain")
        assert "`timeout` of init_process_group" in one["slow"]["says"]
        assert "2000ms" in one["slow"]["says"]
        assert one["dead"]["seconds"] < 30.0  # and not the minute for which it would have waited


def test_without_a_group_or_with_other_than_losses_nothing_is_asked_of_others() -> None:
    from loi_torch.distributed import mean_over_views, sum_gradients

    with pytest.raises(DistributedError, match="mean_over_views needs a process group"):
        mean_over_views(torch.zeros(2))
    with pytest.raises(DistributedError, match="sum_gradients needs a process group"):
        sum_gradients([torch.zeros(2, requires_grad=True)])
    wrong: Any
    for wrong in (torch.zeros(()), torch.zeros(2, dtype=torch.int64), [0.5]):
        with pytest.raises(OptionError, match=r"`losses` must be a floating-point tensor of shape \(views,\), got"):
            mean_over_views(wrong)


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
    with by_arrays():
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr

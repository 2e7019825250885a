"""The loss through Dr.Jit is the core's, in value and gradient, and costs nothing to repeat."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import ImageError, ImageTypeError, NonFiniteImageError, OptionError
from loi_core.support.installed import how_to_install
from loi_mitsuba import LOILoss
from loi_mitsuba.drjit.arrays import aligned_copy
from tests.helpers import Host, images, relative_error

SCALES = ScaleSpace(1, (1, 5), 0.125)
SHAPE = (24, 19, 3)

# Dr.Jit computes in float32 (epsilon 1.2e-7). Some hundred roundings lie between image and loss, which gives 1e-5 in
# the value. Where the two CDFs are within rounding of each other the gradient, a sign, may differ from that in float64;
# random images have a few such pixels and levels in some ten thousand, which move its norm by less than 2e-3.
VALUE, GRADIENT = 1e-5, 2e-3


def attached(image: Host) -> Any:
    """Where Dr.Jit has one kernel for it, wherever NumPy puts the image."""
    tensor = mi.TensorXf(mi.Float(aligned_copy(image.astype(np.float32).reshape(-1))), shape=image.shape)
    dr.enable_grad(tensor)
    return tensor


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax", None])
@pytest.mark.parametrize("scales", [SCALES, ScaleSpace.released((1, 5), (1, 5), 8, 31), None])
def test_value_and_gradient_are_the_core_s(backend: Any, scales: ScaleSpace | None) -> None:
    image, reference = images(SHAPE, 1)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    tensor = attached(image)
    got = LOILoss(reference, scales, backend=backend)(tensor)
    assert type(got) is mi.Float
    assert dr.width(got) == 1
    dr.backward(got)
    assert float(got[0]) == pytest.approx(float(value), rel=VALUE)
    assert relative_error(dr.grad(tensor).numpy(), gradient) < GRADIENT


def test_it_is_a_part_of_a_larger_expression() -> None:
    image, reference = images(SHAPE, 2)
    objective = LOIObjective(reference, SCALES)
    gain, tensor = mi.Float(0.7), mi.TensorXf(image.astype(np.float32))
    dr.enable_grad(gain)
    dr.backward(dr.sin(3.0 * LOILoss(reference, SCALES)(tensor * gain)))
    value, gradient = objective.value_and_grad(0.7 * image)
    wanted = 3.0 * np.cos(3.0 * value) * np.sum(gradient * image)
    assert float(dr.grad(gain)[0]) == pytest.approx(float(wanted), rel=GRADIENT)


def test_forward_mode_gives_the_same_derivative() -> None:
    image, reference = images(SHAPE, 3)
    direction = np.random.default_rng(3).standard_normal(SHAPE)
    tensor = attached(image)
    dr.set_grad(tensor, mi.TensorXf(direction.astype(np.float32)))
    loss = LOILoss(reference, SCALES)(tensor)
    dr.forward_to(loss)
    wanted = np.sum(LOIObjective(reference, SCALES).value_and_grad(image)[1] * direction)
    assert float(dr.grad(loss)[0]) == pytest.approx(float(wanted), rel=10 * GRADIENT)  # the sum cancels


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_without_gradients_it_is_a_plain_value(backend: Any) -> None:
    image, reference = images(SHAPE, 4)
    loss = LOILoss(reference, SCALES, backend=backend)
    value = loss(mi.TensorXf(image.astype(np.float32)))
    assert not dr.grad_enabled(value)
    assert float(value[0]) == pytest.approx(float(LOIObjective(reference, SCALES).value(image)), rel=VALUE)
    with dr.suspend_grad():
        assert not dr.grad_enabled(loss(attached(image)))


def test_channels_may_be_first_or_missing() -> None:
    image, reference = images(SHAPE, 5)
    last = LOILoss(reference, SCALES).value_and_grad(mi.TensorXf(image.astype(np.float32)))
    first = LOILoss(np.moveaxis(reference, -1, 0), SCALES, channel_axis=0)
    value, gradient = first.value_and_grad(mi.TensorXf(np.ascontiguousarray(np.moveaxis(image, -1, 0), np.float32)))
    assert float(value[0]) == pytest.approx(float(last[0][0]), rel=VALUE)
    assert relative_error(np.moveaxis(gradient.numpy(), 0, -1), last[1].numpy()) < GRADIENT
    plain = LOILoss(reference[..., 0], SCALES, channel_axis=None)
    assert plain.value_and_grad(mi.TensorXf(image[..., 0].astype(np.float32)))[1].shape == SHAPE[:2]


def test_masked_pixels_have_no_gradient() -> None:
    image, reference = images(SHAPE, 6)
    image[3, 4] = np.nan
    tensor = attached(image)
    dr.backward(LOILoss(reference, SCALES, nan_policy="mask")(tensor))
    gradient = dr.grad(tensor).numpy()
    assert np.all(gradient[3, 4] == 0.0)
    assert np.all(np.isfinite(gradient))
    with pytest.raises(NonFiniteImageError, match="3 non-finite values"):
        LOILoss(reference, SCALES)(tensor)


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_nothing_is_shared_with_the_caller(backend: Any) -> None:
    image, reference = (one.astype(np.float32) for one in images(SHAPE, 7))
    given = reference.copy()
    loss, same = LOILoss(given, SCALES, backend=backend), LOILoss(mi.TensorXf(given), SCALES, backend=backend)
    tensor = mi.TensorXf(image)  # aliases `image`, but on a GPU
    value, gradient = loss.value_and_grad(tensor)
    kept = gradient.numpy().copy()
    given[:] = 0.0
    for one in (loss, same):
        assert float(one(tensor)[0]) == pytest.approx(float(value[0]), rel=VALUE)
    image[:] = 0.0
    assert np.array_equal(gradient.numpy(), kept)
    if mi.variant().startswith("llvm"):
        assert float(loss(tensor)[0]) != pytest.approx(float(value[0]), rel=VALUE)


def step(loss: LOILoss, image: Host, index: int) -> None:
    tensor = attached(image + index * 1e-3)
    dr.backward(2.0 * loss(tensor))
    dr.eval(dr.grad(tensor))


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_a_loop_compiles_nothing_anew(backend: Any) -> None:
    image, reference = images(SHAPE, 8)
    loss = LOILoss(reference, SCALES, backend=backend)
    counts = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for index in range(6):
            step(loss, image, index)
            history = dr.kernel_history([dr.KernelType.JIT])
            counts.append((len(history), sum(not kernel["cache_hit"] for kernel in history)))
    launches, _ = counts[2]
    assert launches >= 1
    assert counts[2:] == [(launches, 0)] * 4


@pytest.mark.parametrize("offset", [0, 4, 16, 32])
def test_a_gradient_of_numpy_s_has_one_kernel_wherever_it_lies(offset: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dr.Jit compiles for arrays at multiples of 64 bytes, and again for others."""
    image, reference = images(SHAPE, 8)
    loss = LOILoss(reference, SCALES, backend="numpy")
    gradient = loss.value_and_grad(attached(image))[1].numpy()
    room = np.empty(gradient.size + 32, np.float32)
    first = (-room.ctypes.data % 64 + offset) // room.itemsize
    moved = room[first : first + gradient.size].reshape(gradient.shape)
    moved[...] = gradient
    monkeypatch.setattr(type(loss.objective), "value_and_grad", lambda *_: (np.float32(0.0), moved))
    given = loss.value_and_grad(attached(image))[1]
    np.testing.assert_array_equal(given.numpy(), gradient)
    assert given.numpy().ctypes.data % 64 == 0  # which shares its memory


def test_a_loop_does_not_grow() -> None:
    """In a process of its own: what other tests have left to be freed would hide, or feign, a leak of 28 MB."""
    if not Path("/proc/self/statm").exists():
        pytest.skip("no /proc here")
    code = """
import loi_mitsuba, drjit as dr, mitsuba as mi, numpy as np
from loi_core import ScaleSpace
from loi_core.support.installed import how_to_install
mi.set_variant("llvm_ad_rgb")
def pages(): return int(open("/proc/self/statm").read().split()[1])
image = np.random.default_rng(0).uniform(0, 1, (192, 256, 3)).astype(np.float32)
loss = loi_mitsuba.LOILoss(image[::-1].copy(), ScaleSpace(0, 0, 0.5), backend="numpy")
for index in range(60):
    tensor = mi.TensorXf(image + np.float32(index * 1e-3)); dr.enable_grad(tensor)
    dr.backward(loss(tensor)); dr.eval(dr.grad(tensor))
    if index == 9: before = pages()
print((pages() - before) * 4096)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 10 * 192 * 256 * 3 * 4  # ten images, where a leak would keep at least fifty


def test_wrong_arguments_are_named() -> None:
    image, reference = images(SHAPE, 9)
    loss = LOILoss(reference, SCALES)
    with pytest.raises(ImageTypeError, match="`image` must be a TensorXf of a variant with gradients"):
        loss(image)
    with pytest.raises(ImageTypeError, match="TensorXi"):
        loss(mi.TensorXi([1]))
    with pytest.raises(ImageTypeError, match=r"got a numpy\.ndarray"):
        loss.value_and_grad(image)
    with pytest.raises(ImageError, match="image"):
        loss(mi.TensorXf(image[:5].astype(np.float32)))
    with pytest.raises(OptionError, match="`backend` must be one of 'torch', 'numpy', 'jax' or None, got 'cupy'"):
        LOILoss(reference, SCALES, backend="cupy")  # type: ignore[arg-type]


def test_a_missing_backend_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    reference = images(SHAPE, 10)[1]
    monkeypatch.setattr(importlib, "import_module", absent)
    assert LOILoss(reference, SCALES).backend == "numpy"
    with pytest.raises(ImportError, match=r"`backend` is 'torch', which cannot be imported ") as caught:
        LOILoss(reference, SCALES, backend="torch")
    assert str(caught.value).endswith(how_to_install("torch"))


def test_a_torch_that_cannot_see_the_gpu_is_not_chosen_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = images(SHAPE, 11)[1]
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    for sees, wanted in ((False, "numpy"), (True, "torch")):
        monkeypatch.setattr("torch.cuda.is_available", lambda sees=sees: sees)
        assert LOILoss(reference, SCALES).backend == wanted
    assert LOILoss(reference, SCALES, backend="torch").backend == "torch"  # asked for is asked for


def test_freezing_is_refused_by_name_where_it_would_end_the_process() -> None:
    image, reference = (each.astype(np.float32) for each in images(SHAPE, 12))
    loss = LOILoss(reference, SCALES)

    @dr.freeze  # type: ignore[untyped-decorator,unused-ignore]  # Dr.Jit's types are not read
    def frozen(tensor: Any) -> Any:
        return loss(tensor)

    with pytest.raises(RuntimeError) as caught:  # Dr.Jit's own, of what it met while it recorded
        frozen(mi.TensorXf(image))
    assert isinstance(caught.value.__cause__, OptionError)
    assert "under `dr.freeze`" in str(caught.value.__cause__)
    assert float(loss(mi.TensorXf(image))[0]) > 0.0

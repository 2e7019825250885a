"""The loss for Dr.Jit has the value and gradient of the core, and compiles no kernels in a loop."""

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
from mitsuba_boundaries.drjit.arrays import aligned_copy
from tests.helpers import Host, images, relative_error

SCALES = ScaleSpace(1, (1, 5), 0.125)
SHAPE = (24, 19, 3)

# Dr.Jit computes in float32 (epsilon 1.2e-7), and some hundred roundings between image and loss give 1e-5 in the value.
# Where the two CDFs differ by no more than rounding, the sign in the gradient may differ from the sign in float64.
# Random images have a few such pixels and levels in ten thousand, which change the gradient's norm by less than 2e-3.
VALUE_RTOL, GRADIENT_RTOL = 1e-5, 2e-3


def attached(image: Host) -> Any:
    """An attached tensor in aligned memory, so that Dr.Jit has one kernel for all images."""
    tensor = mi.TensorXf(mi.Float(aligned_copy(image.astype(np.float32).reshape(-1))), shape=image.shape)
    dr.enable_grad(tensor)
    return tensor


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax", None])
@pytest.mark.parametrize("scales", [SCALES, ScaleSpace.released((1, 5), (1, 5), 8, 31), None])
def test_value_and_gradient_equal_those_of_the_core(backend: Any, scales: ScaleSpace | None) -> None:
    image, reference = images(SHAPE, 1)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    tensor = attached(image)
    loss = LOILoss(reference, scales, backend=backend)(tensor)
    assert type(loss) is mi.Float
    assert dr.width(loss) == 1
    dr.backward(loss)
    assert float(loss[0]) == pytest.approx(float(value), rel=VALUE_RTOL)
    assert relative_error(dr.grad(tensor).numpy(), gradient) < GRADIENT_RTOL


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_a_call_brings_weights_of_its_image(backend: Any) -> None:
    image, reference = images(SHAPE, 1)
    covered = image[..., 0] > 0.3
    value, gradient = LOIObjective(reference, SCALES).value_and_grad(image, weights=covered)
    loss = LOILoss(reference, SCALES, backend=backend)
    for weights in (mi.TensorXf(covered.astype(np.float32)), covered):
        tensor = attached(image)
        result = loss(tensor, weights=weights)
        dr.backward(result)
        assert float(result[0]) == pytest.approx(float(value), rel=VALUE_RTOL)
        assert relative_error(dr.grad(tensor).numpy(), gradient) < GRADIENT_RTOL
        detached = loss(dr.detach(tensor), weights=weights)
        assert float(detached[0]) == pytest.approx(float(value), rel=VALUE_RTOL)
    with pytest.raises(ImageError, match="`weights` must have shape"):
        loss(tensor, weights=mi.TensorXf(np.ones((24, 19, 1), np.float32)))


def test_the_loss_may_be_part_of_a_larger_expression() -> None:
    image, reference = images(SHAPE, 2)
    objective = LOIObjective(reference, SCALES)
    gain, tensor = mi.Float(0.7), mi.TensorXf(image.astype(np.float32))
    dr.enable_grad(gain)
    dr.backward(dr.sin(3.0 * LOILoss(reference, SCALES)(tensor * gain)))
    value, gradient = objective.value_and_grad(0.7 * image)
    expected = 3.0 * np.cos(3.0 * value) * np.sum(gradient * image)
    assert float(dr.grad(gain)[0]) == pytest.approx(float(expected), rel=GRADIENT_RTOL)


def test_forward_mode_of_the_loss_gives_the_directional_derivative() -> None:
    image, reference = images(SHAPE, 3)
    direction = np.random.default_rng(3).standard_normal(SHAPE)
    tensor = attached(image)
    dr.set_grad(tensor, mi.TensorXf(direction.astype(np.float32)))
    loss = LOILoss(reference, SCALES)(tensor)
    dr.forward_to(loss)
    expected = np.sum(LOIObjective(reference, SCALES).value_and_grad(image)[1] * direction)
    assert float(dr.grad(loss)[0]) == pytest.approx(float(expected), rel=10 * GRADIENT_RTOL)  # the sum cancels


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_the_loss_of_a_detached_image_is_detached(backend: Any) -> None:
    image, reference = images(SHAPE, 4)
    loss = LOILoss(reference, SCALES, backend=backend)
    value = loss(mi.TensorXf(image.astype(np.float32)))
    assert not dr.grad_enabled(value)
    assert float(value[0]) == pytest.approx(float(LOIObjective(reference, SCALES).value(image)), rel=VALUE_RTOL)
    with dr.suspend_grad():
        assert not dr.grad_enabled(loss(attached(image)))


def test_dr_jit_images_may_have_channels_first_or_none() -> None:
    image, reference = images(SHAPE, 5)
    last = LOILoss(reference, SCALES).value_and_grad(mi.TensorXf(image.astype(np.float32)))
    first = LOILoss(np.moveaxis(reference, -1, 0), SCALES, channel_axis=0)
    value, gradient = first.value_and_grad(mi.TensorXf(np.ascontiguousarray(np.moveaxis(image, -1, 0), np.float32)))
    assert float(value[0]) == pytest.approx(float(last[0][0]), rel=VALUE_RTOL)
    assert relative_error(np.moveaxis(gradient.numpy(), 0, -1), last[1].numpy()) < GRADIENT_RTOL
    plain = LOILoss(reference[..., 0], SCALES, channel_axis=None)
    assert plain.value_and_grad(mi.TensorXf(image[..., 0].astype(np.float32)))[1].shape == SHAPE[:2]


def test_non_finite_pixels_of_dr_jit_images_have_no_gradient_when_masked() -> None:
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
def test_the_loss_copies_the_reference_and_the_gradient(backend: Any) -> None:
    image, reference = (array.astype(np.float32) for array in images(SHAPE, 7))
    changed = reference.copy()
    losses = [LOILoss(target, SCALES, backend=backend) for target in (changed, mi.TensorXf(changed))]
    tensor = mi.TensorXf(image)  # shares the memory of `image`, except on a GPU
    value, gradient = losses[0].value_and_grad(tensor)
    original = gradient.numpy().copy()
    changed[:] = 0.0
    for loss in losses:
        assert float(loss(tensor)[0]) == pytest.approx(float(value[0]), rel=VALUE_RTOL)
    image[:] = 0.0
    assert np.array_equal(gradient.numpy(), original)
    if mi.variant().startswith("llvm"):
        assert float(losses[0](tensor)[0]) != pytest.approx(float(value[0]), rel=VALUE_RTOL)


def step(loss: LOILoss, image: Host, index: int) -> None:
    tensor = attached(image + index * 1e-3)
    dr.backward(2.0 * loss(tensor))
    dr.eval(dr.grad(tensor))


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_the_loss_in_a_loop_compiles_no_further_kernel(backend: Any) -> None:
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
def test_gradients_from_numpy_are_aligned_for_dr_jit(offset: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dr.Jit compiles one kernel for arrays at multiples of 64 bytes, and another one for all others."""
    image, reference = images(SHAPE, 8)
    loss = LOILoss(reference, SCALES, backend="numpy")
    gradient = loss.value_and_grad(attached(image))[1].numpy()
    memory = np.empty(gradient.size + 32, np.float32)
    first = (-memory.ctypes.data % 64 + offset) // memory.itemsize
    moved = memory[first : first + gradient.size].reshape(gradient.shape)
    moved[...] = gradient
    monkeypatch.setattr(type(loss.objective), "value_and_grad", lambda *_, **__: (np.float32(0.0), moved))
    tensor = loss.value_and_grad(attached(image))[1]
    np.testing.assert_array_equal(tensor.numpy(), gradient)
    assert tensor.numpy().ctypes.data % 64 == 0  # NumPy shares the tensor's memory


def test_the_loss_in_a_loop_leaks_no_memory() -> None:
    """In a fresh process, because memory that other tests free later would hide or feign a leak of 28 MB."""
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
    assert int(done.stdout) < 10 * 192 * 256 * 3 * 4  # ten images; a leak would keep at least fifty


def test_wrong_arguments_of_the_loss_raise_an_error_that_names_them() -> None:
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


def test_a_missing_array_library_raises_an_error_that_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    reference = images(SHAPE, 10)[1]
    monkeypatch.setattr(importlib, "import_module", absent)
    assert LOILoss(reference, SCALES).backend == "numpy"
    with pytest.raises(ImportError, match=r"`backend` is 'torch', which cannot be imported ") as caught:
        LOILoss(reference, SCALES, backend="torch")
    assert str(caught.value).endswith(how_to_install("torch"))


def test_a_cpu_only_torch_is_not_the_default_in_cuda_variants(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = images(SHAPE, 11)[1]
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    for has_cuda, expected in ((False, "numpy"), (True, "torch")):
        monkeypatch.setattr("torch.cuda.is_available", lambda has_cuda=has_cuda: has_cuda)
        assert LOILoss(reference, SCALES).backend == expected
    assert LOILoss(reference, SCALES, backend="torch").backend == "torch"  # an explicit request is honoured


def test_the_loss_under_dr_freeze_raises_an_error_instead_of_aborting() -> None:
    image, reference = (array.astype(np.float32) for array in images(SHAPE, 12))
    loss = LOILoss(reference, SCALES)

    @dr.freeze  # type: ignore[untyped-decorator,unused-ignore]  # Dr.Jit's types are not read
    def frozen(tensor: Any) -> Any:
        return loss(tensor)

    with pytest.raises(RuntimeError) as caught:  # Dr.Jit wraps errors that occur while it records
        frozen(mi.TensorXf(image))
    assert isinstance(caught.value.__cause__, OptionError)
    assert "under `dr.freeze`" in str(caught.value.__cause__)
    assert float(loss(mi.TensorXf(image))[0]) > 0.0

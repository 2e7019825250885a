"""The loss for Dr.Jit has the value and gradient of the core, and compiles no kernels in a loop."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from loi_core import LOIObjective, ScaleSpace, Target
from loi_core.errors import ImageError, ImageTypeError, NonFiniteImageError, OptionError
from loi_core.support.installed import how_to_install
from loi_mitsuba import loi_loss
from loi_mitsuba.loss import _check_backend, _flat
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


def value_and_grad(image: Host, target: Any, **options: Any) -> tuple[float, Host]:
    """Return the value and the gradient with respect to the image, on NumPy."""
    tensor = attached(image)
    loss = loi_loss(tensor, target, SCALES, backend="numpy", **options)
    dr.backward(loss)
    return float(loss[0]), dr.grad(tensor).numpy()


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax", None])
@pytest.mark.parametrize("scales", [SCALES, ScaleSpace.released((1, 5), (1, 5), 8, 31), None])
def test_value_and_gradient_equal_those_of_the_core(backend: Any, scales: ScaleSpace | None) -> None:
    image, reference = images(SHAPE, 1)
    value, gradient = LOIObjective(reference, scales).value_and_grad(image)
    tensor = attached(image)
    loss = loi_loss(tensor, reference, scales, backend=backend)
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
    for weights in (mi.TensorXf(covered.astype(np.float32)), covered):
        tensor = attached(image)
        result = loi_loss(tensor, reference, SCALES, weights=weights, backend=backend)
        dr.backward(result)
        assert float(result[0]) == pytest.approx(float(value), rel=VALUE_RTOL)
        assert relative_error(dr.grad(tensor).numpy(), gradient) < GRADIENT_RTOL
        detached = loi_loss(dr.detach(tensor), reference, SCALES, weights=weights, backend=backend)
        assert float(detached[0]) == pytest.approx(float(value), rel=VALUE_RTOL)
    with pytest.raises(ImageError, match="`weights` must have shape"):
        loi_loss(tensor, reference, weights=mi.TensorXf(np.ones((24, 19, 1), np.float32)))


def test_the_loss_of_dr_jit_takes_a_target_with_its_weights() -> None:
    image, reference = images(SHAPE, 1)
    opacity = np.linspace(0.0, 1.0, 24 * 19).reshape(SHAPE[:2])
    weights = np.full(SHAPE[:2], 0.5)
    expected, _ = value_and_grad(image, reference, weights=0.5 * opacity)
    value, _ = value_and_grad(image, Target(reference, opacity), weights=mi.TensorXf(weights))
    assert value == pytest.approx(expected, rel=VALUE_RTOL)


def test_the_loss_may_be_part_of_a_larger_expression() -> None:
    image, reference = images(SHAPE, 2)
    objective = LOIObjective(reference, SCALES)
    gain, tensor = mi.Float(0.7), mi.TensorXf(image.astype(np.float32))
    dr.enable_grad(gain)
    dr.backward(dr.sin(3.0 * loi_loss(tensor * gain, reference, SCALES)))
    value, gradient = objective.value_and_grad(0.7 * image)
    expected = 3.0 * np.cos(3.0 * value) * np.sum(gradient * image)
    assert float(dr.grad(gain)[0]) == pytest.approx(float(expected), rel=GRADIENT_RTOL)


def test_forward_mode_of_the_loss_gives_the_directional_derivative() -> None:
    image, reference = images(SHAPE, 3)
    direction = np.random.default_rng(3).standard_normal(SHAPE)
    tensor = attached(image)
    dr.set_grad(tensor, mi.TensorXf(direction.astype(np.float32)))
    loss = loi_loss(tensor, reference, SCALES)
    dr.forward_to(loss)
    expected = np.sum(LOIObjective(reference, SCALES).value_and_grad(image)[1] * direction)
    assert float(dr.grad(loss)[0]) == pytest.approx(float(expected), rel=10 * GRADIENT_RTOL)  # the sum cancels


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_the_loss_of_a_detached_image_is_detached(backend: Any) -> None:
    image, reference = images(SHAPE, 4)
    value = loi_loss(mi.TensorXf(image.astype(np.float32)), reference, SCALES, backend=backend)
    assert not dr.grad_enabled(value)
    assert float(value[0]) == pytest.approx(float(LOIObjective(reference, SCALES).value(image)), rel=VALUE_RTOL)
    with dr.suspend_grad():
        assert not dr.grad_enabled(loi_loss(attached(image), reference, SCALES, backend=backend))


def test_dr_jit_images_may_have_channels_first_or_none() -> None:
    image, reference = images(SHAPE, 5)
    value, gradient = value_and_grad(image, reference)
    for axis in (0, -3):
        first, slope = value_and_grad(*(np.moveaxis(array, -1, 0) for array in (image, reference)), channel_axis=axis)
        assert first == pytest.approx(value, rel=VALUE_RTOL)
        assert relative_error(np.moveaxis(slope, 0, -1), gradient) < GRADIENT_RTOL
    assert value_and_grad(image[..., 0], reference[..., 0], channel_axis=None)[1].shape == SHAPE[:2]
    with pytest.raises(ImageError, match="looks channels first; pass channel_axis=-3"):
        value_and_grad(*(np.moveaxis(array, -1, 0) for array in (image, reference)))


def test_non_finite_pixels_of_dr_jit_images_have_no_gradient_when_masked() -> None:
    image, reference = images(SHAPE, 6)
    image[3, 4] = np.nan
    tensor = attached(image)
    dr.backward(loi_loss(tensor, reference, SCALES, nan_policy="mask"))
    gradient = dr.grad(tensor).numpy()
    assert np.all(gradient[3, 4] == 0.0)
    assert np.all(np.isfinite(gradient))
    with pytest.raises(NonFiniteImageError, match="3 non-finite values"):
        loi_loss(tensor, reference, SCALES)


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_a_target_may_be_a_tensor_and_gets_no_gradient(backend: Any) -> None:
    image, reference = images(SHAPE, 7)
    expected = float(LOIObjective(reference, SCALES).value(image))
    tensor, target = attached(image), attached(reference)
    for passed in (target, reference, reference.astype(np.float32)):
        value = loi_loss(tensor, passed, SCALES, backend=backend)
        assert float(value[0]) == pytest.approx(expected, rel=VALUE_RTOL)
    dr.backward(loi_loss(tensor, target, SCALES, backend=backend))
    assert not np.any(dr.grad(target).numpy())
    assert not dr.grad_enabled(loi_loss(dr.detach(tensor), target, SCALES, backend=backend))


def step(image: Host, target: Any, index: int, backend: Any) -> None:
    tensor = attached(image + index * 1e-3)
    dr.backward(2.0 * loi_loss(tensor, target, SCALES, backend=backend))
    dr.eval(dr.grad(tensor))


@pytest.mark.parametrize("backend", ["numpy", "torch", "jax"])
def test_the_loss_in_a_loop_compiles_no_further_kernel(backend: Any) -> None:
    image, reference = images(SHAPE, 8)
    target = mi.TensorXf(reference.astype(np.float32))
    counts = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for index in range(6):
            step(image, target, index, backend)
            history = dr.kernel_history([dr.KernelType.JIT])
            counts.append((len(history), sum(not kernel["cache_hit"] for kernel in history)))
    launches, _ = counts[2]
    assert launches >= 1
    assert counts[2:] == [(launches, 0)] * 4


@pytest.mark.parametrize("offset", [0, 4, 16, 32])
def test_gradients_from_numpy_are_aligned_for_dr_jit(offset: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dr.Jit compiles one kernel for arrays at multiples of 64 bytes, and another one for all others."""
    image, reference = images(SHAPE, 8)
    gradient = value_and_grad(image, reference)[1]
    memory = np.empty(gradient.size + 32, np.float32)
    first = (-memory.ctypes.data % 64 + offset) // memory.itemsize
    moved = memory[first : first + gradient.size].reshape(gradient.shape)
    moved[...] = gradient
    tensor = _flat(mi.Float, moved)
    np.testing.assert_array_equal(tensor.numpy(), gradient.reshape(-1))
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
target, scales = image[::-1].copy(), ScaleSpace(0, 0, 0.5)
for index in range(60):
    tensor = mi.TensorXf(image + np.float32(index * 1e-3)); dr.enable_grad(tensor)
    dr.backward(loi_mitsuba.loi_loss(tensor, target, scales, backend="numpy")); dr.eval(dr.grad(tensor))
    if index == 9: before = pages()
print((pages() - before) * 4096)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 10 * 192 * 256 * 3 * 4  # ten images; a leak would keep at least fifty


def test_wrong_arguments_of_the_loss_raise_an_error_that_names_them() -> None:
    image, reference = images(SHAPE, 9)
    tensor = mi.TensorXf(image.astype(np.float32))
    with pytest.raises(ImageTypeError, match=r"`image` must be a TensorXf of a variant .* got a numpy\.ndarray"):
        loi_loss(image, reference)
    with pytest.raises(ImageTypeError, match="TensorXi"):
        loi_loss(mi.TensorXi([1]), reference)
    with pytest.raises(ImageError, match=r"`image` has shape .*, which does not fit `target` of shape"):
        loi_loss(mi.TensorXf(image[:5].astype(np.float32)), reference)
    with pytest.raises(OptionError, match="`backend` must be one of 'torch', 'numpy', 'jax' or None, got 'cupy'"):
        loi_loss(tensor, reference, backend="cupy")  # type: ignore[arg-type]


def test_a_missing_array_library_raises_an_error_that_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    tensor = attached(images(SHAPE, 10)[0])
    monkeypatch.setattr("loi_mitsuba.loss.import_library", absent)
    assert _check_backend(None) == "numpy"
    with pytest.raises(ImportError, match=r"`backend` is 'torch', which cannot be imported ") as caught:
        loi_loss(tensor, tensor, backend="torch")
    assert str(caught.value).endswith(how_to_install("torch"))


def test_a_cpu_only_torch_is_not_the_default_in_cuda_variants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    for has_cuda, expected in ((False, "numpy"), (True, "torch")):
        monkeypatch.setattr("torch.cuda.is_available", lambda has_cuda=has_cuda: has_cuda)
        assert _check_backend(None) == expected
    assert _check_backend("torch") == "torch"  # an explicit request is honoured


def test_the_loss_under_dr_freeze_raises_an_error_instead_of_aborting() -> None:
    image, reference = (array.astype(np.float32) for array in images(SHAPE, 12))
    target = mi.TensorXf(reference)

    @dr.freeze  # type: ignore[untyped-decorator,unused-ignore]  # Dr.Jit's types are not read
    def frozen(tensor: Any) -> Any:
        return loi_loss(tensor, target)

    with pytest.raises(RuntimeError) as caught:  # Dr.Jit wraps errors that occur while it records
        frozen(mi.TensorXf(image))
    assert isinstance(caught.value.__cause__, OptionError)
    assert "under `dr.freeze`" in str(caught.value.__cause__)
    assert float(loi_loss(mi.TensorXf(image), target)[0]) > 0.0

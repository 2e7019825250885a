"""The torch module hands the core's gradient to autograd, unchanged, wherever torch may carry it."""

from __future__ import annotations

import copy
import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

from loi_core import LOIObjective, ScaleSpace
from loi_core.errors import DerivativeError, ImageError, ImageTypeError, NonFiniteImageError
from loi_core.stability import allowed
from loi_core.testing import check_objective
from loi_torch import LOILoss, loi_loss
from tests.helpers import images

SCALES = ScaleSpace.paper("path")
IMAGE, REFERENCE = images((2, 17, 23, 3), seed=1)
VALUE, GRADIENT = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)


def leaf(image: Any = IMAGE, **options: Any) -> torch.Tensor:
    return torch.tensor(image, requires_grad=True, **options)


def test_backward_gives_the_gradient_of_the_core() -> None:
    image = leaf()
    value: Any = LOILoss(REFERENCE, SCALES)(image)
    assert value.shape == ()
    (3.0 * value).backward()
    assert value.item() == pytest.approx(float(VALUE), rel=1e-14)
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, 3.0 * GRADIENT, rtol=1e-12, atol=1e-18)


def test_channels_may_come_first() -> None:
    image = leaf(np.moveaxis(IMAGE, -1, -3).copy())
    LOILoss(np.moveaxis(REFERENCE, -1, -3), SCALES, channel_axis=-3)(image).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, np.moveaxis(GRADIENT, -1, -3), rtol=1e-12, atol=1e-18)


def test_the_function_equals_the_module() -> None:
    image = leaf()
    value: Any = loi_loss(torch.tensor(REFERENCE), SCALES)(image)
    value.backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, GRADIENT, rtol=1e-12, atol=1e-18)


def test_functional_gradients_work() -> None:
    gradient = torch.func.grad(LOILoss(REFERENCE, SCALES))(torch.tensor(IMAGE))
    np.testing.assert_allclose(gradient, GRADIENT, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("axis", [0, -1])
def test_vmap_is_a_loop(axis: int) -> None:
    loss = LOILoss(REFERENCE[0], SCALES)
    pairs = [LOIObjective(REFERENCE[0], SCALES).value_and_grad(image) for image in IMAGE]
    values, gradients = map(np.stack, zip(*pairs, strict=True))
    stack = torch.tensor(IMAGE).movedim(0, axis)
    each = torch.func.vmap(loss, in_dims=axis)
    np.testing.assert_allclose(each(stack), values, rtol=1e-13)
    alone = torch.func.vmap(torch.func.grad(loss), in_dims=axis)(stack)
    whole = torch.func.grad(lambda images: each(images).sum())(stack)
    recorded = stack.clone().requires_grad_()
    each(recorded).sum().backward()
    assert recorded.grad is not None
    for gradient in (alone, whole.movedim(axis, 0), recorded.grad.movedim(axis, 0)):
        np.testing.assert_allclose(gradient, gradients, rtol=1e-12, atol=1e-18)


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")  # of torch's own compiler
def test_compiled_code_may_call_it() -> None:
    module = LOILoss(REFERENCE, SCALES)
    for loss in (module, loi_loss(REFERENCE, SCALES)):
        compiled = torch.compile(lambda image, loss=loss: 2.0 * loss(1.0 * image), backend="aot_eager")
        image = leaf()
        compiled(image).backward()
        assert image.grad is not None
        np.testing.assert_allclose(image.grad, 2.0 * GRADIENT, rtol=1e-12, atol=1e-18)
        assert compiled(torch.tensor(IMAGE)).item() == pytest.approx(2.0 * float(VALUE), rel=1e-14)


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")  # of torch's own compiler
def test_compiled_code_may_mask() -> None:
    loss = LOILoss(REFERENCE, SCALES, nan_policy="mask")
    compiled = torch.compile(lambda image: loss(1.0 * image), backend="aot_eager")
    found = []
    for bad in (torch.nan, torch.inf, -torch.inf):
        image = torch.tensor(IMAGE)
        image[0, 3:5, 4, :2] = bad
        image.requires_grad_()
        value = compiled(image)
        value.backward()
        assert image.grad is not None
        assert value.isfinite()
        assert image.grad.isfinite().all()
        assert not image.grad[0, 3:5, 4, :2].any()
        found.append((value.item(), image.grad))
    for other, gradient in found[1:]:
        assert other == found[0][0]
        assert torch.equal(gradient, found[0][1])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
@pytest.mark.parametrize("autocast", [False, True])
def test_low_precision_is_compared_in_float32(dtype: torch.dtype, autocast: bool) -> None:
    image = leaf(dtype=dtype)
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
        value = LOILoss(REFERENCE, SCALES)(image)
    value.backward()
    wanted, gradient = LOIObjective(REFERENCE, SCALES).value_and_grad(image.detach().float().numpy())
    assert value.dtype == torch.float32
    assert value.item() == pytest.approx(float(wanted), rel=1e-5)
    assert image.grad is not None
    assert image.grad.dtype == dtype
    # Either gradient is as close to the plain sum as float32 allows, and then rounded to the image's dtype: by half of
    # its epsilon, and in float16 by half of 6e-8, its least step.
    bound = allowed(image.detach().float().numpy(), REFERENCE, SCALES, torch.finfo(torch.float32).eps).gradient
    rounding = 0.5 * torch.finfo(dtype).eps * (np.abs(gradient) + bound) + (3e-8 if dtype == torch.float16 else 0.0)
    assert np.all(np.abs(image.grad.float().numpy() - gradient) <= 2.0 * bound + rounding)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (lambda image: image.to_sparse(), "must be a dense tensor, got the layout torch.sparse_coo"),
        (lambda image: image.to("meta"), "must hold values, got a tensor on the device 'meta'"),
    ],
)
def test_tensors_without_a_value_for_each_pixel_are_refused(bad: Callable[[Any], Any], says: str) -> None:
    given = bad(torch.tensor(IMAGE))
    with pytest.raises(ImageTypeError, match=f"`image` {says}"):
        LOILoss(REFERENCE, SCALES)(given)
    with pytest.raises(ImageTypeError, match=f"`reference` {says}"):
        LOILoss(given, SCALES)


def test_moving_loading_and_copying_are_followed() -> None:
    image, other = torch.tensor(IMAGE), images(IMAGE.shape, seed=9)[0]
    loss = LOILoss(REFERENCE, SCALES)
    assert loss(image).item() == pytest.approx(float(VALUE))
    loss.load_state_dict(LOILoss(other, SCALES).state_dict())
    wanted = float(LOIObjective(other, SCALES).value(IMAGE))
    assert loss(image).item() == pytest.approx(wanted)
    assert copy.deepcopy(loss)(image).item() == pytest.approx(wanted)
    stream = io.BytesIO()
    torch.save(loss, stream)
    stream.seek(0)
    assert torch.load(stream, weights_only=False)(image).item() == pytest.approx(wanted)
    assert loss.to(torch.float32)(image.float()).dtype == torch.float32
    assert [name for name, _ in loss.named_buffers()] == ["reference"]
    assert "sigma=(1.0, 5.0)" in repr(loss)


def test_what_is_prepared_outside_autograd_serves_inside() -> None:
    loss = LOILoss(REFERENCE, SCALES)
    with torch.no_grad():
        assert not loss(leaf()).requires_grad
    image = leaf()
    loss(image).backward()
    assert image.grad is not None


def test_second_derivatives_are_refused_rather_than_zero() -> None:
    image, loss = leaf(), LOILoss(REFERENCE, SCALES)
    gradient: Any
    (gradient,) = torch.autograd.grad(loss(image), image, create_graph=True)
    with pytest.raises(DerivativeError, match="second derivatives"):
        gradient.sum().backward()
    with pytest.raises(DerivativeError, match="second derivatives"):
        torch.func.grad(lambda given: torch.func.grad(loss)(given).sum())(torch.tensor(IMAGE))
    with pytest.raises(DerivativeError, match="second derivatives"):
        torch.func.jacrev(torch.func.jacrev(LOILoss(np.zeros((2, 2)), channel_axis=None)))(torch.ones(2, 2).double())


def test_what_the_loss_is_multiplied_by_may_be_differentiated_in_the_gradient() -> None:
    image, weight = leaf(), torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    gradient: Any
    (gradient,) = torch.autograd.grad(weight * LOILoss(REFERENCE, SCALES)(image), image, create_graph=True)
    (slope,) = torch.autograd.grad(gradient.square().sum(), weight)
    assert slope.item() == pytest.approx(4.0 * np.sum(GRADIENT**2), rel=1e-12)


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")  # which torch itself uses
def test_forward_mode_is_refused_rather_than_zero() -> None:
    image = torch.tensor(IMAGE)
    module = LOILoss(REFERENCE, SCALES)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(image, torch.ones_like(image))  # type: ignore[no-untyped-call]  # untyped in torch
        for loss in (module, loi_loss(REFERENCE, SCALES)):
            with pytest.raises(DerivativeError, match="forward"):
                loss(dual)
        assert module(image).item() == pytest.approx(float(VALUE), rel=1e-14)
    for transformed in (module, torch.func.grad(module)):
        with pytest.raises(DerivativeError, match="forward"):
            torch.func.jvp(transformed, (image,), (torch.ones_like(image),))


def test_the_value_of_the_core_has_derivatives_in_both_modes() -> None:
    objective, image = LOIObjective(REFERENCE, SCALES), leaf()
    objective.value(image).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, GRADIENT, rtol=1e-9, atol=1e-15)
    along = np.random.default_rng(2).standard_normal(IMAGE.shape)
    both: Any = torch.func.jvp(objective.value, (torch.tensor(IMAGE),), (torch.tensor(along),))
    value, slope = both
    assert value.item() == pytest.approx(float(VALUE), rel=1e-13)
    assert slope.item() == pytest.approx(np.sum(GRADIENT * along), rel=1e-9)


def test_errors_are_those_of_the_core() -> None:
    loss = LOILoss(REFERENCE, SCALES)
    with pytest.raises(ImageTypeError, match="`image` must be a torch tensor, got ndarray"):
        loss(IMAGE)
    with pytest.raises(ImageError, match="does not fit"):
        loss(torch.zeros(2, 5, 5, 3))
    bad = torch.tensor(IMAGE)
    bad[0, 1, 2, 0] = torch.nan
    with pytest.raises(NonFiniteImageError, match=r"1 non-finite value of .*= \(0, 1, 2, 0\)"):
        loss(bad)
    assert LOILoss(REFERENCE, SCALES, nan_policy="mask")(bad).isfinite()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_objective_conforms_on_torch_arrays(dtype: str) -> None:
    check_objective(
        lambda reference: LOIObjective(reference, SCALES),
        asarray=torch.asarray,
        dtype=dtype,
        rtol=1e-2 if dtype == "float64" else 5e-2,
    )


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_gpu_gives_the_same_gradient() -> None:
    image = torch.tensor(IMAGE, device="cuda", requires_grad=True)
    LOILoss(REFERENCE, SCALES).to("cuda")(image).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad.cpu(), GRADIENT, rtol=1e-9, atol=1e-16)


def test_gradients_of_the_core_lie_in_one_piece() -> None:
    image, reference = torch.rand(2, 9, 7, 3), torch.rand(9, 7, 3)
    _, gradient = LOIObjective(reference).value_and_grad(image)
    assert gradient.view(-1).shape == (2 * 9 * 7 * 3,)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
@pytest.mark.parametrize("policy", ["raise", "mask"])
def test_a_new_reference_is_seen_however_it_came(dtype: torch.dtype, policy: Any) -> None:
    others = [torch.tensor(np.random.default_rng(k).uniform(0.1, 0.9, REFERENCE.shape)).to(dtype) for k in range(4)]
    image = torch.tensor(IMAGE).to(dtype)
    loss = LOILoss(others[0], SCALES, nan_policy=policy)
    wanted = [float(LOILoss(other, SCALES)(image)) for other in others]

    def assign(other: torch.Tensor) -> None:
        loss.reference = other.clone()

    ways: list[Callable[[torch.Tensor], object]] = [
        assign,
        lambda other: loss.reference.copy_(other),
        lambda other: loss.reference.data.copy_(other),
        lambda other: loss.load_state_dict({"reference": other}),
        lambda other: loss.load_state_dict({"reference": other.clone()}, assign=True),
    ]
    for way in ways:
        for other, value in zip([*others, *others], [*wanted, *wanted], strict=True):
            way(other)
            assert float(loss(image)) == value


def test_a_reference_that_has_not_changed_is_prepared_once() -> None:
    masked = torch.tensor(REFERENCE)
    masked[0, 0, 0, 0] = torch.nan
    loss = LOILoss(masked, SCALES, nan_policy="mask")
    loss(torch.tensor(IMAGE))
    prepared = loss._objective
    loss(torch.tensor(IMAGE))
    assert loss._objective is prepared


def test_objectives_may_be_made_and_called_in_inference_mode() -> None:
    with torch.inference_mode():
        assert float(LOILoss(torch.tensor(REFERENCE), SCALES)(torch.tensor(IMAGE))) == float(VALUE)
    loss = LOILoss(REFERENCE, SCALES)
    with torch.inference_mode():
        assert float(loss(torch.tensor(IMAGE))) == float(VALUE)
    image = leaf()
    loss(image).backward()
    assert image.grad is not None


def test_a_module_is_printed_with_its_reference_scales_accuracy_and_dtype() -> None:
    loss = LOILoss(REFERENCE.astype(np.float32), SCALES, "balanced", nan_policy="mask", weights=np.ones((17, 23)))
    assert str(loss) == (
        "LOILoss((2, 17, 23, 3), sigma=(1.0, 5.0), alpha=(1.0, 5.0, 15.0, 45.0), beta=(0.125,), accuracy='balanced', "
        "dtype=torch.float32, nan_policy='mask', weights=(17, 23))"
    )
    assert "dtype=torch.float64" in str(torch.nn.Sequential(loss.double()))
    assert "nan_policy" not in str(LOILoss(REFERENCE))

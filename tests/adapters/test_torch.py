"""Tests of the torch loss: the gradient of the core under autograd, torch.func, compilation and low precision."""

from __future__ import annotations

import copy
import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad
from torch.utils._python_dispatch import TorchDispatchMode

from loi_core import LogTone, LOIObjective, ScaleSpace, Target
from loi_core.errors import DerivativeError, ImageError, ImageTypeError, NonFiniteImageError
from loi_core.method import array_comparison
from loi_core.method.dispatch import ARRAY_API
from loi_core.objectives import loi as objectives_loi
from loi_core.objectives import loss as objectives_loss
from loi_core.pixels.exposure import Exposure
from loi_core.stability import allowed
from loi_core.support import arrays
from loi_core.testing import check_objective
from loi_torch import LOILoss, loi_loss
from loi_torch.operator import loss_operator, settings_text
from tests.helpers import images

SCALES = ScaleSpace.paper("path")
IMAGE, REFERENCE = images((2, 17, 23, 3), seed=1)
VALUE, GRADIENT = LOIObjective(REFERENCE, SCALES).value_and_grad(IMAGE)


def leaf(image: Any = IMAGE, **options: Any) -> torch.Tensor:
    return torch.tensor(image, requires_grad=True, **options)


def test_torch_backward_gives_the_gradient_of_the_core() -> None:
    image = leaf()
    value: Any = LOILoss(SCALES)(image, REFERENCE)
    assert value.shape == ()
    (3.0 * value).backward()
    assert value.item() == pytest.approx(float(VALUE), rel=1e-14)
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, 3.0 * GRADIENT, rtol=1e-12, atol=1e-18)


def test_the_torch_module_accepts_images_with_channels_first() -> None:
    image = leaf(np.moveaxis(IMAGE, -1, -3).copy())
    LOILoss(SCALES, channel_axis=-3)(image, np.moveaxis(REFERENCE, -1, -3)).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, np.moveaxis(GRADIENT, -1, -3), rtol=1e-12, atol=1e-18)


def test_the_torch_function_has_the_gradient_of_the_module() -> None:
    image = leaf()
    value: Any = loi_loss(image, torch.tensor(REFERENCE), SCALES)
    value.backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, GRADIENT, rtol=1e-12, atol=1e-18)


def test_torch_func_grad_gives_the_gradient_of_the_core() -> None:
    gradient = torch.func.grad(LOILoss(SCALES))(torch.tensor(IMAGE), torch.tensor(REFERENCE))
    np.testing.assert_allclose(gradient, GRADIENT, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("axis", [0, -1])
def test_torch_vmap_equals_a_loop_over_images(axis: int) -> None:
    loss: Any = partial(LOILoss(SCALES), target=REFERENCE[0])
    pairs = [LOIObjective(REFERENCE[0], SCALES).value_and_grad(image) for image in IMAGE]
    values, gradients = map(np.stack, zip(*pairs, strict=True))
    stack = torch.tensor(IMAGE).movedim(0, axis)
    mapped = torch.func.vmap(loss, in_dims=axis)
    np.testing.assert_allclose(mapped(stack), values, rtol=1e-13)
    vmap_of_grad = torch.func.vmap(torch.func.grad(loss), in_dims=axis)(stack)
    grad_of_vmap = torch.func.grad(lambda batch: mapped(batch).sum())(stack)
    recorded = stack.clone().requires_grad_()
    mapped(recorded).sum().backward()
    assert recorded.grad is not None
    for gradient in (vmap_of_grad, grad_of_vmap.movedim(axis, 0), recorded.grad.movedim(axis, 0)):
        np.testing.assert_allclose(gradient, gradients, rtol=1e-12, atol=1e-18)


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")  # raised by torch.compile
@pytest.mark.filterwarnings("ignore:Dynamo detected a call to a `functools.lru_cache`")  # of array-api-compat
@pytest.mark.parametrize("options", [{"tone": LogTone(8.0), "exposure": "matched"}, {"reduction": "none"}], ids=str)
def test_torch_compile_keeps_the_loss_in_one_graph(options: dict[str, Any]) -> None:
    torch.compiler.reset()
    target, weights = torch.tensor(REFERENCE), torch.linspace(0.0, 1.0, IMAGE[0, ..., 0].size).reshape(IMAGE.shape[1:3])
    for loss in (LOILoss(SCALES, **options), partial(loi_loss, scales=SCALES, **options)):

        def doubled(image: Any, loss: Any = loss) -> Any:
            return 2.0 * loss(1.0 * image, target, weights=weights)

        expected, image = leaf(), leaf()
        value = doubled(expected)
        value.sum().backward()
        compiled = torch.compile(doubled, fullgraph=True, backend="aot_eager")
        traced = compiled(image)
        traced.sum().backward()
        assert torch.equal(traced, value)
        assert image.grad is not None
        assert expected.grad is not None
        torch.testing.assert_close(image.grad, expected.grad)
        assert torch.equal(compiled(torch.tensor(IMAGE)), value.detach())


def test_the_operator_keeps_the_rules_of_operators() -> None:
    arguments = leaf(), torch.tensor(REFERENCE), None, settings_text(LOILoss(SCALES)._settings), True
    torch.library.opcheck(loss_operator, arguments, test_utils=("test_schema", "test_faketensor"))


def test_an_exported_program_has_the_loss_as_one_operator() -> None:
    program = torch.export.export(LOILoss(SCALES), (torch.tensor(IMAGE), torch.tensor(REFERENCE)))
    operators = [node.target for node in program.graph.nodes if node.op == "call_function"]
    assert torch.ops.loi.loss.default in operators
    assert program.module()(torch.tensor(IMAGE), torch.tensor(REFERENCE)).item() == pytest.approx(float(VALUE))


class ReadsValue(TorchDispatchMode):  # type: ignore[no-untyped-call]  # untyped in torch
    """Refuses operations that copy a value to the host, which wait until a GPU is done."""

    def __torch_dispatch__(self, operation: Any, _types: Any, args: Any = (), kwargs: Any = None) -> Any:
        aten = torch.ops.aten
        assert operation not in (aten._local_scalar_dense.default, aten.nonzero.default, aten.is_nonzero.default)
        return operation(*args, **(kwargs or {}))


@pytest.mark.parametrize("exposure", ["given", "matched", "detected"])
@pytest.mark.parametrize("options", [{}, {"nan_policy": "mask", "colours": "differences", "accuracy": "balanced"}])
def test_the_loss_on_a_gpu_reads_no_value(
    monkeypatch: pytest.MonkeyPatch, exposure: Exposure, options: dict[str, Any]
) -> None:
    for module in (array_comparison, arrays):  # as for tensors on a GPU
        monkeypatch.setattr(module, "runs_eagerly_on_host", lambda _: False)
    for module in (array_comparison, arrays, objectives_loi):
        monkeypatch.setattr(module, "values_may_decide", lambda _: False)
    monkeypatch.setattr(objectives_loss, "choose_backend", lambda _: ARRAY_API)
    settings = LOILoss(replace(SCALES, centred=True), exposure=exposure, **options)._settings
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand((2, 12, 10, 3), generator=generator)
    weights = torch.rand((12, 10), generator=generator)
    expected = settings.evaluate(image, target, weights, gradient=True)
    with ReadsValue():  # type: ignore[no-untyped-call]
        results = settings.evaluate(image, target, weights, gradient=True, has_values=False)
    for result, array in zip(results, expected, strict=True):
        assert torch.equal(result, array)


@pytest.mark.parametrize("spoilt", ["image", "target", "weights"])
def test_without_values_to_read_the_loss_of_invalid_pixels_is_nan(spoilt: str) -> None:
    tensors = {"image": torch.tensor(IMAGE), "target": torch.tensor(REFERENCE), "weights": torch.ones(IMAGE.shape[1:3])}
    tensors[spoilt].view(-1)[7] = -1.0 if spoilt == "weights" else torch.inf
    value, gradient = LOILoss(SCALES)._settings.evaluate(*tensors.values(), gradient=True, has_values=False)
    assert value.isnan()
    assert gradient is not None
    assert gradient.isnan().all()
    if spoilt != "weights":  # a pixel of weight 0 may hold anything
        seen = torch.isfinite(tensors[spoilt]).all(dim=-1).all(dim=0)
        value, gradient = LOILoss(SCALES)._settings.evaluate(
            tensors["image"], tensors["target"], seen.float(), gradient=True, has_values=False
        )
        assert value.isfinite()


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")  # raised by torch.compile
def test_the_torch_losses_take_a_target_with_its_weights() -> None:
    target = Target(REFERENCE[0], np.linspace(0.0, 1.0, 17 * 23).reshape(17, 23))
    image = leaf(IMAGE[0])
    expected = loi_loss(image, target.image, SCALES, weights=target.weights)
    assert loi_loss(image, target, SCALES) == expected
    assert LOILoss(SCALES, channel_axis=-3)(image.movedim(-1, -3), target) == expected


def test_torch_compile_accepts_the_mask_policy() -> None:
    loss, target = LOILoss(SCALES, nan_policy="mask"), torch.tensor(REFERENCE)
    compiled = torch.compile(lambda image: loss(1.0 * image, target), backend="aot_eager")
    results = []
    for bad_value in (torch.nan, torch.inf, -torch.inf):
        image = torch.tensor(IMAGE)
        image[0, 3:5, 4, :2] = bad_value
        image.requires_grad_()
        value = compiled(image)
        value.backward()
        assert image.grad is not None
        assert value.isfinite()
        assert image.grad.isfinite().all()
        assert not image.grad[0, 3:5, 4, :2].any()
        results.append((value.item(), image.grad))
    for masked_value, gradient in results[1:]:
        assert masked_value == results[0][0]
        assert torch.equal(gradient, results[0][1])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
@pytest.mark.parametrize("autocast", [False, True])
def test_the_torch_loss_of_a_low_precision_image_is_float32(dtype: torch.dtype, autocast: bool) -> None:
    image = leaf(dtype=dtype)
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
        value: Any = loi_loss(image, REFERENCE, SCALES)
    value.backward()
    expected, gradient = LOIObjective(REFERENCE, SCALES).value_and_grad(image.detach().float().numpy())
    assert value.dtype == torch.float32
    assert value.item() == pytest.approx(float(expected), rel=1e-5)
    assert image.grad is not None
    assert image.grad.dtype == dtype
    # Each gradient is within the float32 bound of the plain sum. Rounding to the image's dtype adds half of its
    # epsilon, and in float16 at least half of 6e-8, the smallest subnormal number.
    bound = allowed(image.detach().float().numpy(), REFERENCE, SCALES, torch.finfo(torch.float32).eps).gradient
    rounding = 0.5 * torch.finfo(dtype).eps * (np.abs(gradient) + bound) + (3e-8 if dtype == torch.float16 else 0.0)
    assert np.all(np.abs(image.grad.float().numpy() - gradient) <= 2.0 * bound + rounding)


@pytest.mark.parametrize(
    ("convert", "message"),
    [
        (lambda image: image.to_sparse(), "must be a dense tensor, got the layout torch.sparse_coo"),
        (lambda image: image.to("meta"), "must hold values, got a tensor on the device 'meta'"),
    ],
)
def test_the_torch_loss_refuses_sparse_and_meta_tensors(convert: Callable[[Any], Any], message: str) -> None:
    tensor = convert(torch.tensor(IMAGE))
    with pytest.raises(ImageTypeError, match=f"`image` {message}"):
        loi_loss(tensor, REFERENCE)
    with pytest.raises(ImageTypeError, match=f"`target` {message}"):
        loi_loss(torch.tensor(IMAGE), tensor)


def test_the_torch_module_keeps_nothing_of_a_target() -> None:
    image, loss = torch.tensor(IMAGE), LOILoss(SCALES)
    other = images(IMAGE.shape, seed=9)[0]
    expected = float(LOIObjective(other, SCALES).value(IMAGE))
    for _ in range(2):
        assert loss(image, REFERENCE).item() == pytest.approx(float(VALUE), rel=1e-14)
        assert loss(image, torch.tensor(other)).item() == pytest.approx(expected, rel=1e-14)
    assert not loss.state_dict()
    stream = io.BytesIO()
    torch.save(loss, stream)
    stream.seek(0)
    for copied in (copy.deepcopy(loss), torch.load(stream, weights_only=False)):
        assert copied(image, other).item() == pytest.approx(expected, rel=1e-14)


def test_a_target_gets_no_gradient_from_torch() -> None:
    target = torch.tensor(REFERENCE, requires_grad=True)
    assert not loi_loss(torch.tensor(IMAGE), target).requires_grad
    LOILoss()(leaf(), target).backward()
    assert target.grad is None
    assert not torch.func.grad(lambda by: loi_loss(torch.tensor(IMAGE), by))(target.detach()).any()


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
@pytest.mark.parametrize("channel_axis", [-1, -3, 0, None])
def test_a_reduction_combines_the_losses_of_the_images_of_a_batch(reduction: Any, channel_axis: int | None) -> None:
    batch, target = np.stack([IMAGE, IMAGE[::-1]])[..., :1], REFERENCE[..., :1]
    weights = np.random.default_rng(3).uniform(size=(2, 2))
    singles = [[LOIObjective(target[index], SCALES).value_and_grad(row[index]) for index in range(2)] for row in batch]
    values = np.array([[float(value) for value, _ in row] for row in singles])
    slopes = np.array([[slope for _, slope in row] for row in singles])
    factors = {"mean": np.full((2, 2), 0.25), "sum": np.ones((2, 2)), "none": weights}[reduction]

    def arranged(array: Any) -> Any:
        return array[..., 0] if channel_axis is None else np.moveaxis(array, -1, channel_axis)

    targets = np.stack([target, target])
    image = leaf(arranged(batch))
    loss: Any = loi_loss(image, arranged(targets), SCALES, channel_axis=channel_axis, reduction=reduction)
    (loss * torch.tensor(weights)).sum().backward() if reduction == "none" else loss.backward()
    assert image.grad is not None
    expected = {"mean": values.mean(), "sum": values.sum(), "none": values}[reduction]
    np.testing.assert_allclose(loss.detach(), expected, rtol=1e-12)
    np.testing.assert_allclose(image.grad, arranged(factors[..., None, None, None] * slopes), rtol=1e-9, atol=1e-16)


def test_torch_vmap_maps_the_target_and_its_weights() -> None:
    weights = np.random.default_rng(4).uniform(size=IMAGE.shape[:-1])
    mapped = torch.func.vmap(lambda *pair: loi_loss(pair[0], pair[1], SCALES, weights=pair[2]))
    values = mapped(torch.tensor(IMAGE), torch.tensor(REFERENCE), torch.tensor(weights))
    expected = [
        float(LOIObjective(target, SCALES).value(image, weights=by))
        for image, target, by in zip(IMAGE, REFERENCE, weights, strict=True)
    ]
    np.testing.assert_allclose(values, expected, rtol=1e-12)


@pytest.mark.parametrize("shape", [(3, 20, 24), (2, 3, 20, 24)])
def test_an_image_with_channels_first_is_an_error_that_names_the_axis(shape: tuple[int, ...]) -> None:
    image = torch.zeros(shape)
    with pytest.raises(ImageError, match="looks channels first; pass channel_axis=-3"):
        LOILoss()(image, image)
    assert float(LOILoss(channel_axis=-3)(image, image)) == 0.0


def test_a_torch_loss_called_under_no_grad_can_be_differentiated_later() -> None:
    loss = LOILoss(SCALES)
    with torch.no_grad():
        assert not loss(leaf(), REFERENCE).requires_grad
    image = leaf()
    loss(image, REFERENCE).backward()
    assert image.grad is not None


def test_the_torch_loss_refuses_second_derivatives() -> None:
    image, loss = leaf(), partial(loi_loss, target=REFERENCE, scales=SCALES)
    gradient: Any
    (gradient,) = torch.autograd.grad(loss(image), image, create_graph=True)
    with pytest.raises(DerivativeError, match="second derivatives"):
        gradient.sum().backward()
    with pytest.raises(DerivativeError, match="second derivatives"):
        torch.func.grad(lambda x: torch.func.grad(loss)(x).sum())(torch.tensor(IMAGE))
    flat = partial(loi_loss, target=np.zeros((2, 2)), channel_axis=None)
    with pytest.raises(DerivativeError, match="second derivatives"):
        torch.func.jacrev(torch.func.jacrev(flat))(torch.ones(2, 2).double())


def test_the_gradient_of_a_weighted_loss_is_differentiable_wrt_the_weight() -> None:
    image, weight = leaf(), torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    gradient: Any
    (gradient,) = torch.autograd.grad(weight * loi_loss(image, REFERENCE, SCALES), image, create_graph=True)
    (slope,) = torch.autograd.grad(gradient.square().sum(), weight)
    assert slope.item() == pytest.approx(4.0 * np.sum(GRADIENT**2), rel=1e-12)


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")  # called by torch itself
def test_the_torch_loss_refuses_forward_mode() -> None:
    image, target = torch.tensor(IMAGE), torch.tensor(REFERENCE)
    module = LOILoss(SCALES)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(image, torch.ones_like(image))  # type: ignore[no-untyped-call]  # untyped in torch
        for loss in (module, loi_loss):
            with pytest.raises(DerivativeError, match="forward"):
                loss(dual, target)
        assert module(image, target).item() == pytest.approx(float(VALUE), rel=1e-14)
    for transformed in (module, torch.func.grad(module)):
        with pytest.raises(DerivativeError, match="forward"):
            torch.func.jvp(lambda x, loss=transformed: loss(x, target), (image,), (torch.ones_like(image),))


@pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated")  # torch calls it at its first forward mode
def test_the_value_of_the_core_has_torch_derivatives_in_both_modes() -> None:
    objective, image = LOIObjective(REFERENCE, SCALES), leaf()
    objective.value(image).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad, GRADIENT, rtol=1e-9, atol=1e-15)
    tangent = np.random.default_rng(2).standard_normal(IMAGE.shape)
    value_and_slope: Any = torch.func.jvp(objective.value, (torch.tensor(IMAGE),), (torch.tensor(tangent),))
    value, slope = value_and_slope
    assert value.item() == pytest.approx(float(VALUE), rel=1e-13)
    assert slope.item() == pytest.approx(np.sum(GRADIENT * tangent), rel=1e-9)


def test_the_torch_loss_raises_the_errors_of_the_core() -> None:
    loss = LOILoss(SCALES)
    with pytest.raises(ImageTypeError, match="`image` must be a torch tensor, got ndarray"):
        loss(IMAGE, REFERENCE)
    with pytest.raises(ImageError, match=r"`image` has shape \(2, 5, 5, 3\), which does not fit `target` of shape"):
        loss(torch.zeros(2, 5, 5, 3), REFERENCE)
    image, target = torch.tensor(IMAGE), torch.tensor(REFERENCE)
    image[0, 1, 2, 0] = torch.nan
    for name, pair in (("image", (image, target)), ("target", (target, image))):
        with pytest.raises(NonFiniteImageError, match=rf"`{name}` has 1 non-finite value of .*= \(0, 1, 2, 0\)"):
            loss(*pair)
    assert LOILoss(SCALES, nan_policy="mask")(image, target).isfinite()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_objective_conforms_on_torch_arrays(dtype: str) -> None:
    check_objective(
        lambda reference: LOIObjective(reference, SCALES),
        asarray=torch.asarray,
        dtype=dtype,
        rtol=1e-2 if dtype == "float64" else 5e-2,
    )


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_torch_gradient_is_equal_on_a_gpu() -> None:
    image = torch.tensor(IMAGE, device="cuda", requires_grad=True)
    LOILoss(SCALES)(image, torch.tensor(REFERENCE, device="cuda")).backward()
    assert image.grad is not None
    np.testing.assert_allclose(image.grad.cpu(), GRADIENT, rtol=1e-9, atol=1e-16)


def test_torch_gradients_of_the_core_are_contiguous() -> None:
    image, reference = torch.rand(2, 9, 7, 3), torch.rand(9, 7, 3)
    _, gradient = LOIObjective(reference).value_and_grad(image)
    assert gradient.view(-1).shape == (2 * 9 * 7 * 3,)


def test_the_torch_loss_can_be_created_and_called_in_inference_mode() -> None:
    with torch.inference_mode():
        loss, target = LOILoss(SCALES), torch.tensor(REFERENCE)
        assert float(loss(torch.tensor(IMAGE), target)) == float(VALUE)
    image = leaf()
    loss(image, target).backward()
    assert image.grad is not None


def test_the_torch_module_prints_its_scales_and_unusual_options() -> None:
    loss = LOILoss(SCALES, "balanced", nan_policy="mask", reduction="none")
    assert str(loss) == (
        "LOILoss(sigma=(1.0, 5.0), alpha=(1.0, 5.0, 15.0, 45.0), beta=(0.125,), accuracy='balanced', "
        "nan_policy='mask', reduction='none')"
    )
    assert str(LOILoss()) == "LOILoss()"

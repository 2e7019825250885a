"""The loss under torch's autograd, with the value and the gradient that the core computes."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Final

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from loi_core import LogTone, ScaleSpace
from loi_core.errors import DerivativeError, ImageTypeError
from loi_core.objectives.facts import unusual_settings
from loi_core.objectives.loss import LossSettings, Reduction, reduced
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.target import image_and_weights
from loi_core.support.arrays import as_floating
from loi_core.support.keywords import suggest_keywords
from loi_torch.operator import NO_SECOND_DERIVATIVES, evaluate, loss_operator, settings_text

__all__ = ["LOILoss", "loi_loss"]

HALF_DTYPES: Final = (torch.float16, torch.bfloat16)
DEFAULT_OPTIONS: Final[dict[str, Any]] = {
    "accuracy": "exact",
    "channel_axis": -1,
    "nan_policy": "raise",
    "exposure": "given",
    "colours": "channels",
    "reduction": "mean",
}


@suggest_keywords
def loi_loss(
    image: Tensor,
    target: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
    reduction: Reduction = "mean",
) -> Tensor:
    """Return the locally orderless image loss of an image and a target.

    Parameters
    ----------
    image : Tensor, shape (*batch, H, W, C)
    target : Tensor, NumPy array or Target, shape (*batch, H, W, C)
        The image to match; batch axes of length 1, and batch axes that it lacks, are repeated. It gets no gradient.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for colour differences.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Axis of the channels: -1 for (N, H, W, C), -3 for (N, C, H, W).
    nan_policy : {"raise", "mask"}
        Treatment of pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range; see :class:`loi_core.LOIObjective`.
    weights : Tensor or NumPy array, shape (H, W) or the image's shape without channels, optional
        Weight of each pixel, such as the mask of the pixels that a warp covers. They get no gradient.
    exposure : {"given", "matched", "regressed", "detected"}
        Treatment of a photograph's exposure; see :class:`loi_core.LOIObjective`.
    colours : {"channels", "differences"}
        Compared quantity; see :class:`loi_core.LOIObjective`.
    reduction : {"mean", "sum", "none"}
        The mean or the sum over the images of a batch, or one value for each image.

    Returns
    -------
    Tensor, shape (), or the shape of the batch for ``reduction="none"``

    Raises
    ------
    LoiError
        As :func:`loi_core.loi_loss`.

    Notes
    -----
    float16 and bfloat16 images are compared in float32, under autocast as well, and the loss is float32; the gradient
    has the image's dtype. ``torch.compile`` and ``torch.export`` keep the loss as one operator, without a graph break.
    ``torch.func.grad``, ``jacrev`` and ``vmap`` work in any order. Second derivatives and forward mode raise a
    DerivativeError. On a GPU no call waits for it: there, value and gradient of an image that is not finite are NaN.
    """
    settings = LossSettings.of(
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        exposure=exposure,
        colours=colours,
        reduction=reduction,
    )
    return _loss(settings, image, target, weights)


@suggest_keywords
class LOILoss(torch.nn.Module):
    """The locally orderless image loss as a module, called with an image and a target.

    Parameters
    ----------
    scales, accuracy, channel_axis, nan_policy, tone, exposure, colours, reduction
        See :func:`loi_loss`.

    Notes
    -----
    The module has no parameters and no buffers. See the notes of :func:`loi_loss`.
    """

    def __init__(
        self,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        exposure: Exposure = "given",
        colours: Colours = "channels",
        reduction: Reduction = "mean",
    ) -> None:
        super().__init__()
        options: dict[str, Any] = {
            "channel_axis": channel_axis,
            "nan_policy": nan_policy,
            "tone": tone,
            "exposure": exposure,
            "colours": colours,
            "reduction": reduction,
        }
        self._settings = LossSettings.of(scales, accuracy, **options)
        self._options = {"accuracy": accuracy, **options}

    def forward(self, image: Tensor, target: Any, weights: Any = None) -> Tensor:
        """Return the loss; parameters, result and errors as in :func:`loi_loss`."""
        return _loss(self._settings, image, target, weights)

    def extra_repr(self) -> str:
        """Return the text that ``print`` shows: the scales, if any were passed, the accuracy, and unusual options."""
        scales = self._settings.scales
        passed = {} if scales is None else {name: getattr(scales, name) for name in ("sigma", "alpha", "beta")}
        unusual = {} if scales is None else unusual_settings(scales)
        options = {name: value for name, value in self._options.items() if value != DEFAULT_OPTIONS.get(name)}
        return ", ".join(f"{name}={value!r}" for name, value in (passed | unusual | options).items())


def _loss(settings: LossSettings, image: Tensor, target: Any, weights: Any) -> Tensor:
    target, weights = image_and_weights(target, weights, settings.pixels.channel_axis)
    compare = _compare_traced if torch.compiler.is_compiling() else _compare
    return compare(settings, image, target, weights)


def _compare_traced(settings: LossSettings, image: Tensor, target: Any, weights: Any) -> Tensor:
    """Compare in a program that ``torch.compile`` or ``torch.export`` traces, with one operator for each value."""
    precise = image.float() if image.dtype in HALF_DTYPES else image
    target, weights = (
        array if array is None else torch.as_tensor(array, device=image.device).detach() for array in (target, weights)
    )
    value: Tensor = reduced(_mean_traced, settings, precise, target, weights)
    return value


def _mean_traced(settings: LossSettings, image: Tensor, target: Any, weights: Any) -> Tensor:
    value: Tensor = loss_operator(image, target, weights, settings_text(settings), _is_recorded(image))[0]
    return value


def _compare(settings: LossSettings, image: Tensor, target: Any, weights: Any) -> Tensor:
    if not isinstance(image, Tensor):
        msg = f"`image` must be a torch tensor, got {type(image).__name__}"
        raise ImageTypeError(msg)
    as_floating("image", image)  # before autocast, which rejects some devices with its own message
    target, weights = (_constant(array, image.device) for array in (target, weights))
    with torch.autocast(image.device.type, enabled=False):
        precise = image.float() if image.dtype in HALF_DTYPES else image
        value: Tensor = reduced(_mean, settings, precise, target, weights)
    return value


def _constant(array: Any, device: torch.device) -> Any:
    """Return a tensor without its graph, and anything else as a tensor on a GPU, if the image is there."""
    if isinstance(array, Tensor):
        return array.detach()
    return array if array is None or device.type == "cpu" else torch.as_tensor(array, device=device)


def _mean(settings: LossSettings, image: Tensor, target: Any, weights: Any) -> Tensor:
    return _evaluate(image, target, weights, settings, gradient=_is_recorded(image))[0]


def _is_recorded(image: Tensor) -> bool:
    return torch.is_grad_enabled() and image.requires_grad


def _evaluate(
    image: Tensor, target: Any, weights: Any, settings: LossSettings, *, gradient: bool
) -> tuple[Tensor, Tensor]:
    arguments = image, target, weights, settings, gradient
    results: tuple[Tensor, Tensor] = _Loss.apply(*arguments)  # type: ignore[no-untyped-call]  # in torch
    return results


class _Loss(torch.autograd.Function):
    """Compute value and gradient in one pass, an empty gradient if none is requested; backward scales it."""

    @staticmethod
    def forward(
        image: Tensor,
        target: Any,
        weights: Any,
        settings: LossSettings,
        gradient: bool,  # noqa: FBT001  # torch passes arguments by position
    ) -> tuple[Tensor, Tensor]:
        return evaluate(image, target, weights, settings, gradient=gradient)

    @staticmethod
    def setup_context(ctx: FunctionCtx, _: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(output[1])

    @staticmethod
    def backward(
        ctx: Any, upstream: Tensor | None, second: Tensor | None
    ) -> tuple[Tensor | None, None, None, None, None]:
        """Scale the gradient. As an output it is no constant to autograd, which may ask for its derivative."""
        if second is not None:
            raise DerivativeError(NO_SECOND_DERIVATIVES)
        (gradient,) = ctx.saved_tensors
        return None if upstream is None else _product(upstream, gradient), None, None, None, None

    @staticmethod
    def jvp(*_: Any) -> Any:
        """Raise an error: only reverse mode is supported."""
        msg = "loi's loss has no forward mode on torch; use backward, torch.func.grad or torch.func.jacrev"
        raise DerivativeError(msg)

    @staticmethod
    def vmap(
        info: Any,
        axes: tuple[int | None, ...],
        images: Tensor,
        targets: Any,
        weights: Any,
        settings: LossSettings,
        gradient: bool,  # noqa: FBT001  # as above
    ) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        """Evaluate image by image: each has its own value, where a batch has one value for all."""
        # A transformation outside of this vmap may record each image even if this one does not.
        separate = (
            [argument] * info.batch_size if axis is None else argument.movedim(axis, 0)
            for argument, axis in zip((images, targets, weights), axes, strict=False)
        )
        results = [
            _evaluate(image, target, image_weights, settings, gradient=gradient or _is_recorded(image))
            for image, target, image_weights in zip(*separate, strict=True)
        ]
        values, gradients = zip(*results, strict=True)
        return (torch.stack(values), torch.stack(gradients)), (0, 0)


def _product(upstream: Tensor, gradient: Tensor) -> Tensor:
    """Return ``upstream * gradient``, on a processor by NumPy.

    torch would wake all its threads, which then spin on the cores that the next step needs.
    """
    if gradient.device.type == "cpu":
        with suppress(RuntimeError):  # tensors of torch.func have no memory of their own
            return torch.from_numpy(upstream.numpy() * gradient.numpy())
    return upstream * gradient

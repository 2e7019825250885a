"""The loss under torch's autograd, with the value and the gradient that the core computes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, TypeVar

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.errors import DerivativeError, ImageTypeError
from loi_core.objectives.facts import unusual_settings
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import as_floating

__all__ = ["LOILoss", "loi_loss"]

HALF_DTYPES: Final = (torch.float16, torch.bfloat16)
DEFAULT_OPTIONS: Final[dict[str, Any]] = {
    "channel_axis": -1,
    "nan_policy": "raise",
    "tone": None,
    "exposure": "given",
    "colours": "channels",
}

Function = TypeVar("Function", bound=Callable[..., Any])


def _without_compilation(function: Function) -> Function:
    """Exclude `function` from ``torch.compile``, which cannot trace functions compiled by Numba."""
    disabled: Function = torch.compiler.disable(function)  # type: ignore[no-untyped-call]  # untyped in torch
    return disabled


class LOILoss(torch.nn.Module):
    """The locally orderless image loss as a module that maps an image to a scalar.

    Parameters
    ----------
    reference : Tensor or NumPy array, shape (*batch, H, W, C)
        Image to match; copied into the buffer ``reference``, which moves with ``.to`` and is saved in the state dict.
        A reference that requires a gradient gets none.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for colour differences.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Axis of the channels: -3 for (N, C, H, W), -1 for (N, H, W, C).
    nan_policy : {"raise", "mask"}
        Treatment of pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range; see :class:`loi_core.LOIObjective`.
    weights : Tensor or NumPy array, shape (H, W), optional
        Weight of each pixel; a mask has weights 0 and 1. See :class:`loi_core.LOIObjective`. Kept in the buffer
        ``weights``. A call may bring weights of its image, which multiply these.
    exposure : {"given", "matched", "regressed", "detected"}
        Treatment of a photograph's exposure; see :class:`loi_core.LOIObjective`.
    colours : {"channels", "differences"}
        Compared quantity; see :class:`loi_core.LOIObjective`.

    Notes
    -----
    float16 and bfloat16 images are compared in float32, under autocast as well, and the loss is float32; the gradient
    has the image's dtype. Under ``torch.compile`` the loss is one graph break. ``torch.func.grad``, ``jacrev`` and
    ``vmap`` work in any order. Second derivatives and forward mode raise a DerivativeError.
    """

    reference: Tensor
    weights: Tensor | None

    def __init__(
        self,
        reference: Any,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Any = None,
        exposure: Exposure = "given",
        colours: Colours = "channels",
    ) -> None:
        super().__init__()
        # The core checks and copies: later writes of the caller to `reference` change nothing.
        objective = LOIObjective(
            reference,
            scales,
            accuracy,
            channel_axis=channel_axis,
            nan_policy=nan_policy,
            tone=tone,
            weights=weights,
            exposure=exposure,
            colours=colours,
        )
        self._options: dict[str, Any] = {
            "scales": objective.scales,
            "accuracy": accuracy,
            "channel_axis": channel_axis,
            "nan_policy": nan_policy,
            "tone": tone,
            "exposure": exposure,
            "colours": colours,
        }
        self.register_buffer("reference", torch.as_tensor(objective.reference))
        self.register_buffer("weights", None if objective.weights is None else torch.as_tensor(objective.weights))
        self._objective: LOIObjective | None = None
        self._weights: Tensor | None = None  # weights of the prepared objective

    @property
    def scales(self) -> ScaleSpace:
        """Compared scales."""
        scales: ScaleSpace = self._options["scales"]
        return scales

    @_without_compilation
    def forward(self, image: Tensor, *, weights: Any = None) -> Tensor:
        """Return the loss of `image`, shape ().

        Parameters
        ----------
        image : Tensor, shape (*batch, H, W, C)
        weights : Tensor or NumPy array, shape (H, W) or the image's shape without channels, optional
            Weight of each pixel of this image, such as the mask of the pixels that a warp covers. They get no gradient.

        Raises
        ------
        LoiError
            As :meth:`loi_core.ImageObjective.value`.
        """
        return _apply(image, weights, self._current())

    def extra_repr(self) -> str:
        """Return the text that ``print`` shows: size and dtype of the reference, scales, accuracy, unusual options."""
        scales, options = self.scales, self._options
        entries = [
            str(tuple(self.reference.shape)),
            *(f"{name}={getattr(scales, name)}" for name in ("sigma", "alpha", "beta")),
            *(f"{name}={value!r}" for name, value in unusual_settings(scales).items()),
            f"accuracy={options['accuracy']!r}",
            f"dtype={self.reference.dtype}",
            *(f"{name}={options[name]!r}" for name, default in DEFAULT_OPTIONS.items() if options[name] != default),
        ]
        return ", ".join(entries if self.weights is None else [*entries, f"weights={tuple(self.weights.shape)}"])

    def _current(self) -> LOIObjective:
        reference = self.reference.detach()
        precise = reference.float() if reference.dtype in HALF_DTYPES else reference
        # The buffer may have been replaced, loaded or written to, also where torch counts no versions (`.data`,
        # inference_mode). Comparing it with the prepared reference takes less than a hundredth of an evaluation.
        weights = None if self.weights is None else self.weights.detach()
        if (
            self._objective is None
            or not _same_bits(precise, self._objective.reference)
            or (weights is not None and (self._weights is None or not torch.equal(weights, self._weights)))
        ):
            self._objective = LOIObjective(precise, weights=weights, **self._options)
            self._weights = None if weights is None else weights.clone()
        return self._objective

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles prepare the objective again.
        return {**self.__dict__, "_objective": None}


def _same_bits(first: Tensor, second: Tensor) -> bool:
    """Return whether dtype, device, shape and bits are equal; NaN, allowed in a reference, equals itself."""
    if first.dtype != second.dtype or first.device != second.device or first.shape != second.shape:
        return False
    integer = torch.int64 if first.dtype == torch.float64 else torch.int32
    return torch.equal(first.view(integer), second.view(integer))


def loi_loss(
    reference: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
) -> LOILoss:
    """Return the locally orderless image loss against a reference, as ``loi_jax.loi_loss`` does.

    Takes the parameters of :class:`LOILoss` and returns one.
    """
    return LOILoss(
        reference,
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        weights=weights,
        exposure=exposure,
        colours=colours,
    )


def _apply(image: Tensor, weights: Any, objective: LOIObjective) -> Tensor:
    if not isinstance(image, Tensor):
        msg = f"`image` must be a torch tensor, got {type(image).__name__}"
        raise ImageTypeError(msg)
    as_floating("image", image)  # before autocast, which rejects some devices with its own message
    with torch.autocast(image.device.type, enabled=False):
        precise = image.float() if image.dtype in HALF_DTYPES else image
        return _evaluate(precise, weights, objective, gradient=_is_recorded(precise))[0]


def _is_recorded(image: Tensor) -> bool:
    return torch.is_grad_enabled() and image.requires_grad


def _evaluate(image: Tensor, weights: Any, objective: LOIObjective, *, gradient: bool) -> tuple[Tensor, Tensor]:
    arguments = image, weights, objective, gradient
    results: tuple[Tensor, Tensor] = _Loss.apply(*arguments)  # type: ignore[no-untyped-call]  # in torch
    return results


class _Loss(torch.autograd.Function):
    """Compute value and gradient in one pass, an empty gradient if none is requested; backward scales it."""

    @staticmethod
    def forward(
        image: Tensor,
        weights: Any,
        objective: LOIObjective,
        gradient: bool,  # noqa: FBT001  # torch passes arguments by position
    ) -> tuple[Tensor, Tensor]:
        if gradient:
            return objective.value_and_grad(image, weights=weights)
        return objective.value(image, weights=weights), image.new_empty(0)

    @staticmethod
    def setup_context(ctx: FunctionCtx, _: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(output[1])

    @staticmethod
    def backward(ctx: Any, upstream: Tensor | None, second: Tensor | None) -> tuple[Tensor | None, None, None, None]:
        """Scale the gradient. As an output it is no constant to autograd, which may ask for its derivative."""
        if second is not None:
            msg = "loi's loss has no second derivatives on torch"
            raise DerivativeError(msg)
        (gradient,) = ctx.saved_tensors
        return None if upstream is None else _product(upstream, gradient), None, None, None

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
        weights: Any,
        objective: LOIObjective,
        gradient: bool,  # noqa: FBT001  # as above
    ) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        """Evaluate image by image: each has its own value, where a batch has one value for all."""
        # A transformation outside of this vmap may record each image even if this one does not.
        separate = (
            [argument] * info.batch_size if axis is None else argument.movedim(axis, 0)
            for argument, axis in zip((images, weights), axes, strict=False)
        )
        results = [
            _evaluate(image, image_weights, objective, gradient=gradient or _is_recorded(image))
            for image, image_weights in zip(*separate, strict=True)
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

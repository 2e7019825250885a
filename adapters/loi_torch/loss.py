"""The loss for torch's autograd: the core computes value and gradient, autograd is handed the gradient."""

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
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import as_floating

__all__ = ["LOILoss", "loi_loss"]

REDUCED: Final = (torch.float16, torch.bfloat16)
USUAL: Final[dict[str, Any]] = {"channel_axis": -1, "nan_policy": "raise", "tone": None, "colours": "channels"}

Function = TypeVar("Function", bound=Callable[..., Any])


def _alone(function: Function) -> Function:
    """`function`, which ``torch.compile`` breaks its graph for: it cannot follow what Numba has compiled."""
    disabled: Function = torch.compiler.disable(function)  # type: ignore[no-untyped-call]  # untyped in torch
    return disabled


class LOILoss(torch.nn.Module):
    """The locally orderless image loss as a module: image in, scalar out.

    Parameters
    ----------
    reference : Tensor or NumPy array, shape (*batch, H, W, C)
        What the image should look like; kept as the buffer ``reference``, so it moves with ``.to`` and is saved in
        the state dict. It is a copy that is not differentiated: a reference that requires a gradient gets none.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        See :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Where the channels are: -3 for torch's usual (N, C, H, W), -1 for (N, H, W, C).
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range; see :class:`loi_core.LOIObjective`.
    weights : Tensor or NumPy array, shape (H, W), optional
        How much each pixel counts; a mask is weights of 0 and 1. See :class:`loi_core.LOIObjective`. Kept as the
        buffer ``weights``.
    colours : {"channels", "differences"}
        What of the colours is compared; see :class:`loi_core.LOIObjective`.

    Notes
    -----
    float16 and bfloat16 images are compared in float32, under autocast as well, and the loss is float32; the gradient
    comes back in the image's dtype. Under ``torch.compile`` the loss is one graph break. ``torch.func.grad``,
    ``jacrev`` and ``vmap`` take it, in any order. Its gradient cannot be differentiated again: second derivatives
    raise a DerivativeError instead of being silently zero, and so does forward mode.
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
        colours: Colours = "channels",
    ) -> None:
        super().__init__()
        # The core checks the arguments, and copies: later writes of the caller to `reference` change nothing.
        objective = LOIObjective(
            reference,
            scales,
            accuracy,
            channel_axis=channel_axis,
            nan_policy=nan_policy,
            tone=tone,
            weights=weights,
            colours=colours,
        )
        self._options: dict[str, Any] = {
            "scales": objective.scales,
            "accuracy": accuracy,
            "channel_axis": channel_axis,
            "nan_policy": nan_policy,
            "tone": tone,
            "colours": colours,
        }
        self.register_buffer("reference", torch.as_tensor(objective.reference))
        self.register_buffer("weights", None if objective.weights is None else torch.as_tensor(objective.weights))
        self._objective: LOIObjective | None = None
        self._weights: Tensor | None = None  # that it was made with

    @property
    def scales(self) -> ScaleSpace:
        """The scales that are compared."""
        scales: ScaleSpace = self._options["scales"]
        return scales

    @_alone
    def forward(self, image: Tensor) -> Tensor:
        """The loss of `image`, a tensor of shape (); errors as :meth:`loi_core.ImageObjective.value`."""
        return _apply(image, self._current())

    def extra_repr(self) -> str:
        """What ``print`` shows of it: size and dtype of the reference, scales, accuracy and what is not usual."""
        scales, options = self.scales, self._options
        parts = [
            str(tuple(self.reference.shape)),
            *(f"{name}={getattr(scales, name)}" for name in ("sigma", "alpha", "beta")),
            *(f"{name}={value!r}" for name, value in unusual_settings(scales).items()),
            f"accuracy={options['accuracy']!r}",
            f"dtype={self.reference.dtype}",
            *(f"{name}={options[name]!r}" for name, usual in USUAL.items() if options[name] != usual),
        ]
        return ", ".join(parts if self.weights is None else [*parts, f"weights={tuple(self.weights.shape)}"])

    def _current(self) -> LOIObjective:
        reference = self.reference.detach()
        precise = reference.float() if reference.dtype in REDUCED else reference
        # The buffer may have been replaced, loaded or written to, also where torch keeps no count of it (`.data`, under
        # inference_mode). To compare it with what is prepared takes less than a hundredth of an evaluation.
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
        # What is prepared can be prepared again; copies and pickles need not carry it.
        return {**self.__dict__, "_objective": None}


def _same_bits(one: Tensor, other: Tensor) -> bool:
    """Whether two tensors are equal and alike; NaN, which may be in a reference, equals itself."""
    if one.dtype != other.dtype or one.device != other.device or one.shape != other.shape:
        return False
    whole = torch.int64 if one.dtype == torch.float64 else torch.int32
    return torch.equal(one.view(whole), other.view(whole))


def loi_loss(
    reference: Any,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Any = None,
    colours: Colours = "channels",
) -> LOILoss:
    """The locally orderless image loss against a reference, as a function of the image; as ``loi_jax.loi_loss``.

    Parameters are those of :class:`LOILoss`, which is what comes back.
    """
    return LOILoss(
        reference,
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        weights=weights,
        colours=colours,
    )


def _apply(image: Tensor, objective: LOIObjective) -> Tensor:
    if not isinstance(image, Tensor):
        msg = f"`image` must be a torch tensor, got {type(image).__name__}"
        raise ImageTypeError(msg)
    as_floating("image", image)  # autocast does not know every device, and says so in words of its own
    with torch.autocast(image.device.type, enabled=False):
        precise = image.float() if image.dtype in REDUCED else image
        return _evaluate(precise, objective, gradient=_is_recorded(precise))[0]


def _is_recorded(image: Tensor) -> bool:
    return torch.is_grad_enabled() and image.requires_grad


def _evaluate(image: Tensor, objective: LOIObjective, *, gradient: bool) -> tuple[Tensor, Tensor]:
    found: tuple[Tensor, Tensor] = _Loss.apply(image, objective, gradient)  # type: ignore[no-untyped-call]  # in torch
    return found


class _Loss(torch.autograd.Function):
    """Value and gradient in one pass, the latter empty if it is not wanted; backward only scales it."""

    @staticmethod
    def forward(
        image: Tensor,
        objective: LOIObjective,
        gradient: bool,  # noqa: FBT001  # torch hands over arguments by position
    ) -> tuple[Tensor, Tensor]:
        return objective.value_and_grad(image) if gradient else (objective.value(image), image.new_empty(0))

    @staticmethod
    def setup_context(ctx: FunctionCtx, _: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(output[1])

    @staticmethod
    def backward(ctx: Any, upstream: Tensor | None, second: Tensor | None) -> tuple[Tensor | None, None, None]:
        """Scale the gradient. As a result like the value it is no constant to autograd, which asks for its slope."""
        if second is not None:
            msg = "loi's loss has no second derivatives on torch; its gradient alone can be had"
            raise DerivativeError(msg)
        (gradient,) = ctx.saved_tensors
        return None if upstream is None else _product(upstream, gradient), None, None

    @staticmethod
    def jvp(*_: Any) -> Any:
        """Only reverse mode is there."""
        msg = "loi's loss has no forward mode on torch; use backward, torch.func.grad or torch.func.jacrev"
        raise DerivativeError(msg)

    @staticmethod
    def vmap(
        _: Any,
        axes: tuple[int, None, None],
        images: Tensor,
        objective: LOIObjective,
        gradient: bool,  # noqa: FBT001  # as above
    ) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        """One image after another: each has a value of its own, where a batch has one for all."""
        # What is outside of this vmap may record each of them, which those in it do not tell.
        each = images.movedim(axes[0], 0)
        found = [_evaluate(image, objective, gradient=gradient or _is_recorded(image)) for image in each]
        values, gradients = zip(*found, strict=True)
        return (torch.stack(values), torch.stack(gradients)), (0, 0)


def _product(upstream: Tensor, gradient: Tensor) -> Tensor:
    """``upstream * gradient``; on the processor by NumPy.

    torch would wake all of its threads for it, which then wait for more to do on the cores that the next step needs.
    """
    if gradient.device.type == "cpu":
        with suppress(RuntimeError):  # what torch.func hands over has no memory of its own
            return torch.from_numpy(upstream.numpy() * gradient.numpy())
    return upstream * gradient

"""The loss as an operator, which ``torch.compile`` and ``torch.export`` keep as one call.

Its settings travel as text, so that an exported program can be loaded by another process. Autograd outside of traced
programs uses :class:`torch.autograd.Function`, because operators with a backward pass of their own do not take part in
``torch.func`` (https://github.com/pytorch/pytorch/issues/128020 asks for it).
"""

from __future__ import annotations

import ast
import functools
from dataclasses import fields
from typing import Any, Final

import torch
from torch import Tensor

from loi_core import LogTone, ScaleSpace
from loi_core.errors import DerivativeError
from loi_core.objectives.loss import LossSettings

__all__ = ["NO_SECOND_DERIVATIVES", "evaluate", "loss_operator", "settings_text"]

SCALE_FIELDS: Final = tuple(field.name for field in fields(ScaleSpace))

NO_SECOND_DERIVATIVES: Final = "loi's loss has no second derivatives on torch"


def settings_text(settings: LossSettings) -> str:
    """Return the settings of a loss as text, except their reduction."""
    scales, pixels, tone = settings.scales, settings.pixels, settings.pixels.tone
    options = {
        "scales": None if scales is None else tuple(getattr(scales, name) for name in SCALE_FIELDS),
        "accuracy": settings.tolerance,
        "channel_axis": pixels.channel_axis,
        "nan_policy": pixels.nan_policy,
        "tone": None if tone is None else (tone.peak, tone.compression),
        "exposure": pixels.exposure,
        "colours": pixels.colours,
    }
    return f"{options!r}"


@functools.lru_cache(maxsize=256)
def _settings(text: str) -> LossSettings:
    options: dict[str, Any] = ast.literal_eval(text)
    scales, tone = options.pop("scales"), options.pop("tone")
    return LossSettings.of(
        None if scales is None else ScaleSpace(**dict(zip(SCALE_FIELDS, scales, strict=True))),
        tone=None if tone is None else LogTone(*tone),
        reduction="mean",
        **options,
    )


@torch.library.custom_op("loi::loss", mutates_args=())
def loss_operator(
    image: Tensor, target: Tensor, weights: Tensor | None, settings: str, gradient: bool
) -> tuple[Tensor, Tensor]:
    """Return the value, shape (), and the gradient by the image, an empty tensor unless it is requested."""
    return evaluate(image, target, weights, _settings(settings), gradient=gradient)


def evaluate(
    image: Tensor, target: Any, weights: Any, settings: LossSettings, *, gradient: bool
) -> tuple[Tensor, Tensor]:
    """Return what :func:`loss_operator` does, for settings that are no text."""
    has_values = image.device.type == "cpu"  # reading values of a GPU would wait until it is done
    value, slope = settings.evaluate(image, target, weights, gradient=gradient, has_values=has_values)
    # A traced program relies on the strides that `_fake` announces.
    return value, image.new_empty(0) if slope is None else slope.contiguous()


@loss_operator.register_fake
def _fake(
    image: Tensor, _target: Tensor, _weights: Tensor | None, _settings: str, gradient: bool
) -> tuple[Tensor, Tensor]:
    slope = torch.empty_like(image, memory_format=torch.contiguous_format) if gradient else image.new_empty(0)
    return image.new_empty(()), slope


def _save_gradient(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    del inputs
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(output[1])


def _backward(ctx: Any, upstream: Tensor | None, second: Tensor | None) -> tuple[Tensor | None, None, None, None, None]:
    if second is not None:
        raise DerivativeError(NO_SECOND_DERIVATIVES)
    (gradient,) = ctx.saved_tensors
    return None if upstream is None else upstream * gradient, None, None, None, None


loss_operator.register_autograd(_backward, setup_context=_save_gradient)

"""The loss as one operation of Dr.Jit's automatic differentiation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal, TypeAlias, cast, get_args

import drjit as dr
import mitsuba as mi

from loi_core import LogTone, ScaleSpace
from loi_core.errors import ImageTypeError, LoiError, OptionError
from loi_core.objectives.loss import LossSettings
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.target import Target, image_and_weights
from loi_core.support.arrays import Array, is_read_by_numpy, namespace, to_numpy
from loi_core.support.installed import how_to_install, import_library
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown
from mitsuba_boundaries.drjit.arrays import ALIGNMENT_BYTES, aligned_copy

__all__ = ["Backend", "BackendMissingError", "loi_loss"]

Backend = Literal["torch", "numpy", "jax"]

Tensor: TypeAlias = Any
"""A Dr.Jit tensor, ``mi.TensorXf``, whose class depends on the variant."""

Float: TypeAlias = Any
"""A flat Dr.Jit array, ``mi.Float``."""

EXPORTS: Final[dict[str, Callable[[Tensor], Array]]] = {
    "torch": lambda tensor: tensor.torch(),
    "numpy": lambda tensor: tensor.numpy(),
    "jax": lambda tensor: tensor.jax(),
}


class BackendMissingError(LoiError, ImportError):
    """The requested array library is not installed."""


@suggest_keywords
def loi_loss(
    image: Tensor,
    target: Tensor | Target | Array,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Tensor | Array | None = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
    backend: Backend | None = None,
) -> Float:
    """Return the distance of a render from a target, which ``dr.backward`` differentiates.

    Parameters
    ----------
    image : mi.TensorXf, shape (H, W, C)
        As ``mi.render`` returns it.
    target : mi.TensorXf, array or Target, shape (H, W, C)
        The image to match. It gets no gradient.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient allowed in exchange for time; see :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Axis of the channels; None for images without channels.
    nan_policy : {"raise", "mask"}
        Whether non-finite pixels raise an error or are ignored.
    tone : LogTone, optional
        A tone curve for images of high dynamic range, as ``mi.render`` gives them; see :class:`loi_core.LOIObjective`.
    weights : mi.TensorXf or array, shape (H, W), optional
        Weight of each pixel, such as the mask of the pixels to compare. They get no gradient.
    exposure : {"given", "matched", "regressed", "detected"}
        Treatment of a photograph's exposure; see :class:`loi_core.LOIObjective`.
    colours : {"channels", "differences"}
        Which colour features are compared; see :class:`loi_core.LOIObjective`.
    backend : {"torch", "numpy", "jax"}, optional
        The array library that computes the loss. By default torch if it is installed and supports Mitsuba's device,
        or else NumPy.

    Returns
    -------
    mi.Float, width 1
        Attached if `image` is.

    Raises
    ------
    BackendMissingError
        If `backend` is not installed.
    OptionError
        Under ``dr.freeze``.
    LoiError
        As :func:`loi_core.loi_loss`, for the other arguments.

    Notes
    -----
    The array library shares the image's memory without a copy, except NumPy in CUDA variants: only torch and JAX keep
    the image on the GPU. A call evaluates the value and the gradient at once. It adds nothing to Dr.Jit's kernels, so
    they are compiled once, and ``dr.backward`` only scales the gradient. Dr.Jit itself may hang where several threads
    of a process render at once; use one process for each.

    Examples
    --------
    >>> image = mi.render(scene, params, spp=16)        # doctest: +SKIP
    >>> dr.backward(loi_loss(image, photograph))        # doctest: +SKIP
    """
    export = EXPORTS[_check_backend(backend)]
    settings = LossSettings.of(
        scales,
        accuracy,
        channel_axis=channel_axis,
        nan_policy=nan_policy,
        tone=tone,
        exposure=exposure,
        colours=colours,
        reduction="mean",
    )
    if dr.flag(dr.JitFlag.FreezingScope):  # reading the image would abort the process
        msg = "loi_loss cannot be called in a function under `dr.freeze`; freeze the rendering, and call it outside"
        raise OptionError(msg)
    _check_tensor(image)
    target, weights = (
        export(dr.detach(array)) if array is not None and dr.is_tensor_v(array) else array
        for array in (target, weights)
    )
    target, weights = image_and_weights(target, weights, channel_axis)
    is_attached: bool = dr.grad_enabled(image)
    value, slope = settings.evaluate(export(dr.detach(image)), target, weights, gradient=is_attached)
    flat = _flat(type(image.array), value)
    if slope is None:
        return flat
    # Evaluated outside the operation, because Dr.Jit hides errors inside it behind a RuntimeError.
    gradient = type(image)(_flat(type(image.array), slope), shape=image.shape)
    return dr.custom(_Loss, image, flat, gradient)


class _Loss(dr.CustomOp):  # type: ignore[misc]  # Dr.Jit's types are not read, see pyproject.toml
    """An operation with a precomputed value and gradient; both modes only scale the gradient."""

    def eval(self, image: Tensor, value: Float, gradient: Tensor) -> Float:  # noqa: ARG002 - `image` is the differentiable input
        self.gradient = gradient
        return value

    def forward(self) -> None:
        self.set_grad_out(dr.sum(self.grad_in("image").array * self.gradient.array))

    def backward(self) -> None:
        self.set_grad_in("image", self.gradient * self.grad_out())

    def name(self) -> str:
        return "loi"


def _flat(array_type: Any, array: Array) -> Float:
    """Convert `array` to a flat Dr.Jit array, without a copy if it is contiguous and aligned."""
    flat = namespace(array).reshape(array, (-1,))
    if is_read_by_numpy(flat):
        host = to_numpy(flat)
        if host.ctypes.data % ALIGNMENT_BYTES:
            flat = aligned_copy(host)
    return array_type(flat)


def _check_tensor(image: object) -> None:
    if not (dr.is_tensor_v(image) and dr.is_diff_v(image) and dr.is_float_v(image)):
        name = f"{type(image).__module__}.{type(image).__name__}"
        msg = f"`image` must be a TensorXf of a variant with gradients (llvm_ad_..., cuda_ad_...), got a {name}"
        raise ImageTypeError(msg)


def _check_backend(backend: object) -> Backend:
    if backend is None:
        return _default_backend()
    if not isinstance(backend, str) or backend not in get_args(Backend):
        msg = f"`backend` must be one of {', '.join(map(repr, get_args(Backend)))} or None, got {shown(backend)}"
        raise OptionError(msg)
    try:
        import_library(backend)
    except ImportError as error:
        msg = f"`backend` is {backend!r}, which cannot be imported ({error}); {how_to_install(backend)}"
        raise BackendMissingError(msg) from None
    return cast("Backend", backend)


def _default_backend() -> Backend:
    try:
        torch = import_library("torch")
    except ImportError:
        return "numpy"
    # A CPU-only torch cannot read an image on a GPU. JAX can, but is never the default, because it would reserve most
    # of the GPU memory that Mitsuba needs.
    if str(mi.variant()).startswith("cuda") and not torch.cuda.is_available():
        return "numpy"
    return "torch"

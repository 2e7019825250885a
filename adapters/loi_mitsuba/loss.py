"""The loss as one operation of Dr.Jit's automatic differentiation."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Final, Literal, TypeAlias, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from loi_core import LogTone, LOIObjective, ScaleSpace
from loi_core.errors import ImageTypeError, LoiError, OptionError
from loi_core.pixels.colours import Colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array, namespace
from loi_core.support.installed import how_to_install
from loi_core.support.wording import shown
from mitsuba_boundaries.drjit.arrays import ALIGNMENT_BYTES, aligned_copy

__all__ = ["Backend", "BackendMissingError", "LOILoss"]

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


class LOILoss:
    """The distance of a render from a reference, as a loss that ``dr.backward`` differentiates.

    Parameters
    ----------
    reference : mi.TensorXf or array, shape (H, W, C)
        The target image. It is copied, so later changes to it have no effect.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient allowed in exchange for time; see :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Axis of the channels in the reference and in the images; None for images without channels.
    nan_policy : {"raise", "mask"}
        Whether non-finite pixels raise an error or are ignored.
    tone : LogTone, optional
        A tone curve for images of high dynamic range, as ``mi.render`` gives them; see :class:`loi_core.LOIObjective`.
    weights : mi.TensorXf or array, shape (H, W), optional
        Weights of the pixels; a mask has weights of 0 and 1. See :class:`loi_core.LOIObjective`.
    exposure : {"given", "matched", "regressed", "detected"}
        Treatment of a photograph's exposure; see :class:`loi_core.LOIObjective`.
    colours : {"channels", "differences"}
        Which colour features are compared; see :class:`loi_core.LOIObjective`.
    backend : {"torch", "numpy", "jax"}, optional
        The array library that computes the loss. By default torch if it is installed and supports Mitsuba's device,
        or else NumPy.

    Raises
    ------
    BackendMissingError
        If `backend` is not installed.
    LoiError
        As :class:`loi_core.LOIObjective`, for the other arguments.

    Notes
    -----
    The array library shares the image's memory without a copy, except NumPy in CUDA variants: only torch and JAX keep
    the image on the GPU. A call evaluates the value and the gradient at once. It adds nothing to Dr.Jit's kernels, so
    they are compiled once, and ``dr.backward`` only scales the gradient. Dr.Jit itself may hang where several threads
    of a process render at once; use one process for each.

    Examples
    --------
    >>> loss = LOILoss(reference)                       # doctest: +SKIP
    >>> image = mi.render(scene, params, spp=16)        # doctest: +SKIP
    >>> dr.backward(loss(image))                        # doctest: +SKIP
    """

    def __init__(
        self,
        reference: Tensor | Array,
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
    ) -> None:
        self._backend = _check_backend(backend)
        reference, weights = _host(reference), _host(weights)
        self._objective = LOIObjective(
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

    def __repr__(self) -> str:
        return f"<loi_mitsuba.LOILoss on {self._backend} by {self._objective!r}>"

    @property
    def objective(self) -> LOIObjective:
        """The objective of the core that computes the loss."""
        return self._objective

    @property
    def backend(self) -> Backend:
        """The array library that computes the loss."""
        return self._backend

    def __call__(self, image: Tensor, *, weights: Tensor | Array | None = None) -> Float:
        """Return the loss at `image`.

        Parameters
        ----------
        image : mi.TensorXf, shape (H, W, C)
            As ``mi.render`` returns it.
        weights : mi.TensorXf or array, shape (H, W), optional
            Weight of each pixel of this image, such as the mask of the pixels that a warp covers. The weights of the
            reference are multiplied by them. They get no gradient.

        Returns
        -------
        mi.Float, width 1
            Attached if `image` is.

        Raises
        ------
        ImageTypeError, ImageError
            If the type or shape does not fit the reference, or `weights` do not fit the image or are negative.
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a pixel is NaN or infinite.
        OptionError
            Under ``dr.freeze``.
        """
        _check_not_frozen()
        _check_tensor(image)
        if not dr.grad_enabled(image):
            export = EXPORTS[self._backend]
            return _flat(type(image.array), self._objective.value(export(image), weights=self._exported(weights)))
        # Evaluated outside the operation, because Dr.Jit hides errors inside it behind a RuntimeError.
        return dr.custom(_Loss, image, *self.value_and_grad(image, weights=weights))

    def value_and_grad(self, image: Tensor, *, weights: Tensor | Array | None = None) -> tuple[Float, Tensor]:
        """Return the detached loss and its gradient with respect to `image`, of the same type; as a call otherwise."""
        _check_not_frozen()
        _check_tensor(image)
        exported = EXPORTS[self._backend](dr.detach(image))
        value, gradient = self._objective.value_and_grad(exported, weights=self._exported(weights))
        flat = _flat(type(image.array), gradient)
        return _flat(type(image.array), value), type(image)(flat, shape=image.shape)

    def _exported(self, weights: Any) -> Any:
        """Convert a Dr.Jit tensor to an array of the backend; return anything else unchanged."""
        is_tensor = weights is not None and dr.is_tensor_v(weights)
        return EXPORTS[self._backend](dr.detach(weights)) if is_tensor else weights


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


def _host(array: Any) -> Any:
    """Convert a Dr.Jit tensor to NumPy; return anything else unchanged."""
    return dr.detach(array).numpy() if array is not None and dr.is_tensor_v(array) else array


def _flat(array_type: Any, array: Array) -> Float:
    """Convert `array` to a flat Dr.Jit array, without a copy if it is contiguous and aligned."""
    flat = namespace(array).reshape(array, (-1,))
    if isinstance(flat, np.ndarray) and flat.ctypes.data % ALIGNMENT_BYTES:
        flat = aligned_copy(flat)
    return array_type(flat)


def _check_not_frozen() -> None:
    """Raise :class:`OptionError` while ``dr.freeze`` records: reading the image would then abort the process."""
    if dr.flag(dr.JitFlag.FreezingScope):
        msg = "LOILoss cannot be called in a function under `dr.freeze`; freeze the rendering, and call it outside"
        raise OptionError(msg)


def _check_tensor(image: object) -> None:
    if not (dr.is_tensor_v(image) and dr.is_diff_v(image) and dr.is_float_v(image)):
        name = f"{type(image).__module__}.{type(image).__name__}"
        msg = f"`image` must be a TensorXf of a variant with gradients (llvm_ad_..., cuda_ad_...), got a {name}"
        raise ImageTypeError(msg)


def _check_backend(backend: object) -> Backend:
    if backend is None:
        return _default_backend()
    for name in get_args(Backend):
        if isinstance(backend, str) and backend == name:
            try:
                importlib.import_module(name)
            except ImportError as error:
                msg = f"`backend` is {name!r}, which cannot be imported ({error}); {how_to_install(name)}"
                raise BackendMissingError(msg) from None
            return name  # type: ignore[no-any-return]  # one of the literals
    msg = f"`backend` must be one of {', '.join(map(repr, get_args(Backend)))} or None, got {shown(backend)}"
    raise OptionError(msg)


def _default_backend() -> Backend:
    try:
        torch = importlib.import_module("torch")
    except ImportError:
        return "numpy"
    # A CPU-only torch cannot read an image on a GPU. JAX can, but is never the default, because it would reserve most
    # of the GPU memory that Mitsuba needs.
    if str(mi.variant()).startswith("cuda") and not torch.cuda.is_available():
        return "numpy"
    return "torch"

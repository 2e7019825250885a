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
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.support.arrays import Array, namespace
from loi_core.support.installed import how_to_install
from loi_core.support.wording import shown
from loi_mitsuba.drjit.arrays import ALIGNMENT_BYTES, aligned_copy

__all__ = ["Backend", "BackendMissingError", "LOILoss"]

Backend = Literal["torch", "numpy", "jax"]

Tensor: TypeAlias = Any
"""A tensor of Dr.Jit, ``mi.TensorXf``; its type depends on the variant, so there is no one name to give."""

Float: TypeAlias = Any
"""A flat array of Dr.Jit, ``mi.Float``."""

EXPORTS: Final[dict[str, Callable[[Tensor], Array]]] = {
    "torch": lambda tensor: tensor.torch(),
    "numpy": lambda tensor: tensor.numpy(),
    "jax": lambda tensor: tensor.jax(),
}


class BackendMissingError(LoiError, ImportError):
    """The array library that was asked for is not installed."""


class LOILoss:
    """The distance of a render from a reference, as a loss that ``dr.backward`` differentiates.

    Parameters
    ----------
    reference : mi.TensorXf or array, shape (H, W, C)
        What the image should look like. It is copied; later writes to it change nothing.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient allowed in exchange for time; see :class:`loi_core.LOIObjective`.
    channel_axis : int or None
        Where the channels are, in the reference and in the images; None for images without channels.
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range, as ``mi.render`` gives them; see :class:`loi_core.LOIObjective`.
    weights : mi.TensorXf or array, shape (H, W), optional
        How much each pixel counts; a mask is weights of 0 and 1. See :class:`loi_core.LOIObjective`.
    colours : {"channels", "differences"}
        What of the colours is compared; see :class:`loi_core.LOIObjective`.
    backend : {"torch", "numpy", "jax"}, optional
        The array library that does the work. By default torch if it is installed, and computes on GPUs if Mitsuba's
        variant does, or else NumPy.

    Raises
    ------
    BackendMissingError
        If `backend` is not installed.
    LoiError
        As :class:`loi_core.LOIObjective`, for the other arguments.

    Notes
    -----
    Memory is shared with the array library, not copied, except that NumPy cannot see a GPU: in CUDA variants only
    torch and JAX keep the image there. The loss is evaluated when it is called, and value and gradient together; it
    adds nothing to Dr.Jit's kernels, so they are compiled once, and ``dr.backward`` only scales the gradient.
    Dr.Jit itself may hang where several threads of a process render at once; give each a process of its own.

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
            colours=colours,
        )

    def __repr__(self) -> str:
        return f"<loi_mitsuba.LOILoss on {self._backend} by {self._objective!r}>"

    @property
    def objective(self) -> LOIObjective:
        """The objective of the core that does the work."""
        return self._objective

    @property
    def backend(self) -> Backend:
        """The array library that does the work."""
        return self._backend

    def __call__(self, image: Tensor) -> Float:
        """The loss at `image`.

        Parameters
        ----------
        image : mi.TensorXf, shape (H, W, C)
            As ``mi.render`` returns it.

        Returns
        -------
        mi.Float, width 1
            Attached if `image` is.

        Raises
        ------
        ImageTypeError, ImageError
            If the type or shape does not fit the reference.
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a pixel is NaN or infinite.
        OptionError
            Under ``dr.freeze``.
        """
        _check_not_frozen()
        _check_tensor(image)
        if not dr.grad_enabled(image):
            return _flat(type(image.array), self._objective.value(EXPORTS[self._backend](image)))
        # Evaluated out here: an error inside the operation would reach the caller as a RuntimeError that hides it.
        return dr.custom(_Loss, image, *self.value_and_grad(image))

    def value_and_grad(self, image: Tensor) -> tuple[Float, Tensor]:
        """The loss, detached, and its gradient by the image, a tensor like it. Errors as of a call."""
        _check_not_frozen()
        _check_tensor(image)
        value, gradient = self._objective.value_and_grad(EXPORTS[self._backend](dr.detach(image)))
        flat = _flat(type(image.array), gradient)
        return _flat(type(image.array), value), type(image)(flat, shape=image.shape)


class _Loss(dr.CustomOp):  # type: ignore[misc]  # Dr.Jit's types are not read, see pyproject.toml
    """A value whose gradient is known; derivatives in either direction only scale that gradient."""

    def eval(self, image: Tensor, value: Float, gradient: Tensor) -> Float:  # noqa: ARG002 - what it is attached to
        self.gradient = gradient
        return value

    def forward(self) -> None:
        self.set_grad_out(dr.sum(self.grad_in("image").array * self.gradient.array))

    def backward(self) -> None:
        self.set_grad_in("image", self.gradient * self.grad_out())

    def name(self) -> str:
        return "loi"


def _host(array: Any) -> Any:
    """A tensor of Dr.Jit as NumPy; anything else as it is."""
    return dr.detach(array).numpy() if array is not None and dr.is_tensor_v(array) else array


def _flat(kind: Any, array: Array) -> Float:
    """`array` as a flat array of Dr.Jit, without a copy where it is contiguous and aligned."""
    flat = namespace(array).reshape(array, (-1,))
    if isinstance(flat, np.ndarray) and flat.ctypes.data % ALIGNMENT_BYTES:
        flat = aligned_copy(flat)
    return kind(flat)


def _check_not_frozen() -> None:
    """Raise :class:`OptionError` where ``dr.freeze`` records, which ends the process when the image is looked at."""
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
    for known in get_args(Backend):
        if isinstance(backend, str) and backend == known:
            try:
                importlib.import_module(known)
            except ImportError as error:
                msg = f"`backend` is {known!r}, which cannot be imported ({error}); {how_to_install(known)}"
                raise BackendMissingError(msg) from None
            return known  # type: ignore[no-any-return]  # one of the literals
    msg = f"`backend` must be one of {', '.join(map(repr, get_args(Backend)))} or None, got {shown(backend)}"
    raise OptionError(msg)


def _default_backend() -> Backend:
    try:
        torch = importlib.import_module("torch")
    except ImportError:
        return "numpy"
    # A torch that was built for processors only cannot take an image on a GPU. JAX, which could, is not chosen unless
    # asked for: it would reserve most of the GPU's memory, which Mitsuba needs.
    if str(mi.variant()).startswith("cuda") and not torch.cuda.is_available():
        return "numpy"
    return "torch"

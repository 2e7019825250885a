"""What every image objective shares: its interface, and the handling of layouts, libraries and bad pixels."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from loi_core.errors import ImageError, ImageTypeError, OptionError
from loi_core.method.ways import BY_ARRAYS, Way
from loi_core.objectives.facts import facts_of_options, facts_of_reference, in_notebook, printed
from loi_core.pixels.layout import Layout, check_channel_axis
from loi_core.pixels.nonfinite import NanPolicy, check_nan_policy, require_finite
from loi_core.pixels.tone_curve import LogTone, check_tone
from loi_core.pixels.weights import PixelWeights
from loi_core.support.arrays import (
    Array,
    Host,
    as_floating,
    detached,
    device,
    from_numpy,
    is_numpy_array,
    is_traced,
    library_name,
    namespace,
    narrowed,
    norm,
    to_numpy,
    widened,
)

__all__ = ["Evaluation", "ImageObjective", "Objective"]

MAX_PREPARED: Final = 4  # kinds of image (shape, dtype, device) that one objective keeps the reference ready for

PreparedT = TypeVar("PreparedT")
KeyT = TypeVar("KeyT")


@runtime_checkable
class Objective(Protocol):
    """A number that says how far an image is from a reference, and its gradient."""

    def value(self, image: Array) -> Array:
        """The objective, as a 0-d array of the image's library, dtype and device."""

    def value_and_grad(self, image: Array) -> tuple[Array, Array]:
        """The objective and its gradient by the image; the gradient has the image's shape."""


@dataclass(frozen=True)
class Evaluation(Generic[KeyT]):
    """What one evaluation on planes gives.

    Attributes
    ----------
    terms : dict
        They sum to the value.
    gradient : array, shape (N, H, W), optional
        If it was asked for.
    better : callable, optional
        From the 2-norm of the gradient once it has been carried back to the image, and the most that it was multiplied
        by on the way, to a gradient to take instead; None if this one is accurate enough.
    """

    terms: dict[KeyT, Array]
    gradient: Array | None
    better: Callable[[float, float], Array | None] | None = None


@dataclass(frozen=True)
class _Ready(Generic[PreparedT]):
    """The reference as one array library, dtype and device sees it, after the tone curve."""

    planes: Array
    seen: Array | None  # where pixels are compared; None if that is everywhere
    prepared: PreparedT


class ImageObjective(abc.ABC, Generic[PreparedT, KeyT]):
    """Base of the objectives that compare an image with a reference of the same shape.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        Real floating point. A NumPy array serves images of every library; one of another library serves
        images of that library. Fewer batch axes than the image are broadcast. It is copied; later writes to it
        change nothing.
    channel_axis : int or None
        Where the channels are, in the reference and in the images; None if there are none, (*batch, H, W).
        Count from the end (-3 for channels first) when reference and images differ in batch axes.
    nan_policy : {"raise", "mask"}
        "raise" stops at the first NaN or infinite pixel. "mask" takes such pixels, of either image, as equal to
        the reference; they add nothing, their gradient is 0, and the mean is still over all pixels.
    tone : LogTone, optional
        A tone curve for images of high dynamic range: image and reference pass it before they are compared, and its
        derivative is part of the gradient.
    weights : array, shape (H, W) or that of the reference without channels, optional
        How much each pixel counts, 0 or more; a mask is weights of 0 and 1. What a pixel adds to every comparison is
        multiplied by its weight, and the mean is still over all pixels. Pixels of weight 0 are taken as equal to the
        reference, whatever they hold, so that blurs see no edge there.

    Notes
    -----
    Batches are averaged: the value is one number, the mean over the images of the batch. Images of 16 bits are compared
    in float32; value and gradient are rounded to the image's dtype at the end.
    """

    def __init__(
        self,
        reference: Array,
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        self._channel_axis = check_channel_axis(channel_axis)
        self._nan_policy = check_nan_policy(nan_policy)
        self._tone = check_tone(tone)
        reference = detached(as_floating("reference", reference))
        self._reference_layout = Layout.of("reference", reference.shape, self._channel_axis)
        self._pixel_weights = None if weights is None else PixelWeights.of(weights, self._reference_layout)
        if self._pixel_weights is not None and not self.takes_weights and not self._pixel_weights.is_mask:
            msg = f"`weights` of {type(self).__name__} must be a mask, of 0 and one other value; it knows no others"
            raise OptionError(msg)
        if self._nan_policy == "raise":
            require_finite("reference", self.visible(reference), self._channel_axis)
        xp = namespace(reference)
        self._reference = xp.asarray(reference, copy=True)
        self._ready: dict[tuple[Any, ...], _Ready[PreparedT]] = {}

    takes_weights: ClassVar[bool] = False
    """Whether :meth:`compare_planes` counts pixels by weights; if not, masks are taken and other weights refused."""

    def __getstate__(self) -> dict[str, Any]:
        # What is prepared can be prepared again; copies and pickles need not carry it.
        return {**self.__dict__, "_ready": {}}

    def __repr__(self) -> str:
        return printed(type(self).__name__, self._facts())

    def _repr_html_(self) -> str:
        return in_notebook(type(self).__name__, self._facts(), self._reference, self._channel_axis)

    def _facts(self) -> dict[str, str]:
        """What is said of it, for those who override it."""
        weights = None if self.weights is None else self.weights.shape
        return facts_of_reference(self._reference.shape, self._reference.dtype) | facts_of_options(
            self._channel_axis, self._nan_policy, self._tone, weights
        )

    @property
    def reference(self) -> Array:
        """The reference as it was given, in its own library and dtype."""
        return self._reference

    @property
    def channel_axis(self) -> int | None:
        """Where the channels are."""
        return self._channel_axis

    @property
    def nan_policy(self) -> NanPolicy:
        """What happens to pixels that are not finite."""
        return self._nan_policy

    @property
    def tone(self) -> LogTone | None:
        """The tone curve that image and reference pass."""
        return self._tone

    @property
    def weights(self) -> Host | None:
        """How much each pixel counts, shape (*batch, H, W), float64; None if all count alike."""
        return None if self._pixel_weights is None else self._pixel_weights.values

    def value(self, image: Array) -> Array:
        """The objective at `image`.

        Parameters
        ----------
        image : array, shape (*batch, H, W, C)
            Real floating point, of any library of the array API standard.

        Returns
        -------
        array, shape ()
            Of the image's library, dtype and device.

        Raises
        ------
        ImageTypeError, ImageError
            If the type or shape does not fit the reference.
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a pixel is NaN or infinite.
        """
        return narrowed(_total(self._evaluate_image(image, gradient=False)[0]), image)

    def value_and_grad(self, image: Array) -> tuple[Array, Array]:
        """The objective at `image` and its gradient, an array like `image`. Errors as in :meth:`value`."""
        # The gradient is ours; a framework that recorded the way to it would only waste time and memory.
        terms, gradient = self._evaluate_image(detached(image), gradient=True)
        return narrowed(_total(terms), image), narrowed(gradient, image)

    def terms(self, image: Array) -> dict[KeyT, Array]:
        """The parts of the value, which sum to it. Errors as in :meth:`value`."""
        terms, _ = self._evaluate_image(image, gradient=False)
        return {key: narrowed(term, image) for key, term in terms.items()}

    def prepare(self, shape: tuple[int, ...], like: Array) -> None:
        """Make the reference ready for images of `shape` and arrays like `like`, for :meth:`evaluate_unchecked`."""
        self._ready_for(widened(like), Layout.of("image", shape, self._channel_axis), BY_ARRAYS)

    def check_shape(self, shape: tuple[int, ...]) -> None:
        """Raise :class:`ImageError` if images of `shape` cannot be compared; evaluating does so by itself."""
        layout = Layout.of("image", shape, self._channel_axis)
        self._require_same_axes(layout)
        layout.require_fit("image", self._reference_layout)

    def visible(self, image: Array) -> Array:
        """`image`, shape (*batch, H, W, C), with 0 in the pixels of weight 0, which may hold anything."""
        if not self._weights_hide or self._pixel_weights is None:
            return image
        layout = Layout.of("image", image.shape, self._channel_axis)
        planes = layout.to_planes(image)
        xp = namespace(planes)
        return layout.to_image(
            xp.where(self._pixel_weights.planes(layout, planes) > 0.0, planes, xp.zeros_like(planes))
        )

    @property
    def _weights_hide(self) -> bool:
        return self._pixel_weights is not None and self._pixel_weights.hide

    def evaluate_unchecked(self, image: Array, like: Array, *, gradient: bool) -> tuple[Array, Array | None]:
        """Value, and gradient if asked for, of an image whose pixels cannot be looked at, such as a JAX tracer.

        Parameters
        ----------
        image : array, shape (*batch, H, W, C)
            Its type and shape are checked, its values are not: under ``nan_policy="raise"`` the caller sees to them.
        like : array
            A concrete array of the image's library, dtype and device, for which the reference is prepared.
        gradient : bool
            Whether the gradient is wanted; None comes in its place otherwise.
        """
        terms, slope = self._evaluate_image(image, gradient=gradient, like=like)
        return narrowed(_total(terms), image), None if slope is None else narrowed(slope, image)

    @abc.abstractmethod
    def prepare_reference(self, reference: Array, weights: Array | None) -> PreparedT:
        """Make once what depends on the reference alone. For those who write an objective; see :meth:`compare_planes`.

        Parameters
        ----------
        reference : array, shape (N, H, W)
            Every channel of every image of the batch is a plane; finite, and past the tone curve.
        weights : array, shape (N, H, W), optional
            How much each pixel counts, in [0, 1]; None if all count alike, and always None unless `takes_weights`.
        """

    @abc.abstractmethod
    def compare_planes(self, planes: Array, prepared: PreparedT, *, gradient: bool) -> Evaluation[KeyT]:
        """Compare an image with the reference. For those who write an objective: this is all there is to compute.

        Layouts, batches, dtypes, pixels that are not finite, masks and the tone curve have been seen to.

        Parameters
        ----------
        planes : array, shape (N, H, W)
            Of the same library, dtype and device as the reference that was prepared.
        prepared : object
            What :meth:`prepare_reference` made.
        gradient : bool
            Whether the gradient by `planes` is wanted.

        Returns
        -------
        Evaluation
            Terms that sum to the value, a mean over all planes and pixels, and the gradient.
        """

    def choose_way(self, image: Array) -> Way:  # noqa: ARG002  # for those who override it
        """Where images like this are compared: in their own library, unless an objective knows better."""
        return BY_ARRAYS

    def _evaluate_image(
        self, image: Array, *, gradient: bool, like: Array | None = None
    ) -> tuple[dict[KeyT, Array], Array | None]:
        image = widened(as_floating("image", image))
        layout = Layout.of("image", image.shape, self._channel_axis)
        way = self.choose_way(image)
        ready = self._ready_for(image if like is None else widened(like), layout, way)
        here = way.take(image)
        planes = layout.to_planes(here)
        xp = namespace(planes)
        seen = ready.seen
        if self._nan_policy == "mask":
            seen = xp.isfinite(planes) if seen is None else xp.isfinite(planes) & seen
        if seen is not None:
            planes = xp.where(seen, planes, xp.zeros_like(planes))  # so that no curve, nor its slope, meets them
        if self._nan_policy == "raise" and like is None:
            require_finite("image", here if seen is None else layout.to_image(planes), self._channel_axis)
        compared = self._toned(planes)
        if seen is not None:
            compared = xp.where(seen, compared, ready.planes)
        evaluation = self.compare_planes(compared, ready.prepared, gradient=gradient)
        terms, cotangent = evaluation.terms, evaluation.gradient
        if cotangent is not None:
            cotangent = self._carried_back(planes, seen, cotangent)
            if evaluation.better is not None:
                other = evaluation.better(norm(cotangent), self._largest_factor(planes))
                cotangent = cotangent if other is None else self._carried_back(planes, seen, other)
            cotangent = layout.to_image(cotangent)
        if self._pixel_weights is not None and self._pixel_weights.largest != 1.0:
            terms = {key: term * self._pixel_weights.largest for key, term in terms.items()}
            cotangent = None if cotangent is None else cotangent * self._pixel_weights.largest
        terms = {key: way.give(term, image) for key, term in terms.items()}
        return terms, None if cotangent is None else way.give(cotangent, image)

    def _carried_back(self, planes: Array, seen: Array | None, cotangent: Array) -> Array:
        """A cotangent of what is compared, by the planes as they came: through the tone curve, 0 where not `seen`."""
        if self._tone is not None:
            cotangent = self._tone.pullback(planes, cotangent)
        if seen is not None:
            xp = namespace(cotangent)
            cotangent = xp.where(seen, cotangent, xp.zeros_like(cotangent))
        return cotangent

    def _largest_factor(self, planes: Array) -> float:
        """The most that a cotangent is multiplied by on its way back; `planes` are on the host."""
        if self._tone is None:
            return 1.0
        return float(np.max(to_numpy(self._tone.pullback(planes, namespace(planes).ones_like(planes)))))

    def _ready_for(self, like: Array, layout: Layout, way: Way) -> _Ready[PreparedT]:
        self._require_same_axes(layout)
        key = (library_name(like), str(like.dtype), str(device(like)), layout.shape, way)
        ready = self._ready.get(key)
        if ready is None:
            ready = self._make_ready(like, layout, way)
            # What JAX makes while it traces is of no use once the trace has ended.
            if not is_traced(namespace(ready.planes).zeros(())):
                # A new dict each time, as other threads may be reading the old one.
                kept = list(self._ready.items())[1 - MAX_PREPARED :]
                self._ready = dict([*kept, (key, ready)])
        return ready

    def _require_same_axes(self, layout: Layout) -> None:
        fewer = layout.channel_axis is not None and len(layout.shape) != len(self._reference_layout.shape)
        if fewer and (self._channel_axis or 0) >= 0:
            msg = (
                f"`channel_axis` must count from the end (-3 for channels first) when batches differ; it is "
                f"{self._channel_axis}, `image` has shape {layout.shape}, the reference {self._reference_layout.shape}"
            )
            raise ImageError(msg)

    def _make_ready(self, like: Array, layout: Layout, way: Way) -> _Ready[PreparedT]:
        planes = layout.broadcast_planes("image", self._reference_like(like), self._reference_layout)
        planes = way.take(planes)
        xp = namespace(planes)
        shares = None if self._pixel_weights is None else self._pixel_weights.planes(layout, planes)
        seen = None if shares is None or not self._weights_hide else shares > 0.0
        if self._nan_policy == "mask":
            seen = xp.isfinite(planes) if seen is None else xp.isfinite(planes) & seen
        if seen is not None:
            # A pixel that is hidden keeps what the reference has there, if that is a number.
            planes = xp.where(xp.isfinite(planes), planes, xp.zeros_like(planes))
        planes = self._toned(planes)
        return _Ready(planes, seen, self.prepare_reference(planes, shares if self.takes_weights else None))

    def _toned(self, planes: Array) -> Array:
        return planes if self._tone is None else self._tone.apply(planes)

    def _reference_like(self, image: Array) -> Array:
        if is_numpy_array(self._reference):
            return from_numpy(self._reference, image)
        if library_name(self._reference) != library_name(image):
            msg = (
                f"`image` is an array of {library_name(image)}, the reference of {library_name(self._reference)}; "
                f"give the reference as NumPy to serve every library"
            )
            raise ImageTypeError(msg)
        if device(self._reference) != device(image):
            msg = f"`image` is on device {device(image)}, the reference on {device(self._reference)}"
            raise ImageTypeError(msg)
        return namespace(image).astype(self._reference, image.dtype)


def _total(terms: Mapping[Any, Array]) -> Array:
    parts = list(terms.values())
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total

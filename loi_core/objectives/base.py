"""The shell of every image objective: its interface, its options, and the reference prepared for each kind of image."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar, runtime_checkable

from loi_core.errors import ImageTypeError
from loi_core.method.dispatch import ARRAY_API, Backend, choose_backend
from loi_core.objectives.evaluation import PlaneComparison, PreparedObjective, ReferencePlanes
from loi_core.objectives.facts import facts_of_options, facts_of_reference, objective_html, summary_line
from loi_core.pixels.exposure import Exposure, LinearExposure, check_exposure
from loi_core.pixels.layout import Layout, check_channel_axis
from loi_core.pixels.nonfinite import NanPolicy, check_nan_policy, require_finite
from loi_core.pixels.pipeline import PixelPipeline, PixelSettings
from loi_core.pixels.target import Target, image_and_weights
from loi_core.pixels.tone_curve import LogTone, check_tone
from loi_core.pixels.weights import CallWeights, PixelWeights, require_mask
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
    widened,
)
from loi_core.support.keywords import suggest_keywords

__all__ = ["ImageObjective", "Objective", "reference_like", "total"]

MAX_PREPARED_KINDS: Final = 4  # prepared references of one objective, by shape, dtype and device of the images

KeyT = TypeVar("KeyT")


@runtime_checkable
class Objective(Protocol):
    """A distance between an image and a reference, with its gradient."""

    def value(self, image: Array) -> Array:
        """Return the value, a 0-d array of the image's library, dtype and device."""

    def value_and_grad(self, image: Array) -> tuple[Array, Array]:
        """Return the value and its gradient with respect to the image, which has the image's shape."""


@suggest_keywords
class ImageObjective(abc.ABC, Generic[KeyT]):
    """Base of the objectives that compare an image with a reference of the same shape.

    An objective is a ``PixelPipeline`` and a :class:`PlaneComparison`; a subclass
    provides the second by :meth:`compare_with`.

    Parameters
    ----------
    reference : array or Target, shape (*batch, H, W, C)
        Real floating point, or the result of :func:`loi_core.read_target`, whose weights are multiplied by `weights`.
        A NumPy array serves images of every library; an array of another library serves
        images of that library. Fewer batch axes than the image are broadcast. It is copied; later writes to it
        change nothing.
    channel_axis : int or None
        Axis of the channels, in the reference and in the images; None if there are none, (*batch, H, W).
        Count from the end (-3 for channels first) when reference and images differ in batch axes.
        Under -1 an image that looks channels first is an error: its last axis has 5 or more entries, as has the
        second from last, and the third from last has 1, 3 or 4. Say 2 if (3, 64, 48) is 3 x 64 pixels of 48 channels.
    nan_policy : {"raise", "mask"}
        "raise" raises an error if a pixel is NaN or infinite. "mask" treats such pixels, of either image, as equal to
        the reference; they add nothing, their gradient is 0, and the mean is still over all pixels.
    tone : LogTone, optional
        A tone curve for images of high dynamic range, applied to image and reference before they are compared; its
        derivative is part of the gradient.
    weights : array, shape (H, W) or the reference's shape without channels, optional
        Weight of each pixel, 0 or more; a mask is weights of 0 and 1. The contribution of a pixel to every comparison
        is multiplied by its weight, and the mean is still over all pixels. Pixels of weight 0 are treated as equal to
        the reference, whatever they hold, so that blurs see no edge there. A call may add weights of its image.
    exposure : {"given", "matched", "regressed", "detected"}
        "matched" gives each channel of the image the mean and deviation of the reference before they are compared, at
        every evaluation, and "regressed" the gain and offset of least absolute differences, for images that are nearly
        aligned. "detected" regresses them too, and leaves a channel whose intensities in [0, 1] they would change by
        less than half a step of 8 bits. The gradient holds gain and offset. The brightness of the whole image has no
        effect then.

    Notes
    -----
    Batches are averaged: the value is one number, the mean over the images of the batch. Images of 16 bits are compared
    in float32; value and gradient are rounded to the image's dtype at the end.
    """

    takes_weights: ClassVar[bool] = False
    """Whether the comparison uses weights of pixels; if not, only masks are accepted, which the pipeline applies."""

    runs_on_numba: ClassVar[bool] = False
    """Whether :meth:`compare_with` accepts references of every backend; if not, only of the image's own library."""

    def __init__(
        self,
        reference: Target | Array,
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
        exposure: Exposure = "given",
    ) -> None:
        reference, weights = image_and_weights(reference, weights, channel_axis)
        axis, policy, tone = check_channel_axis(channel_axis), check_nan_policy(nan_policy), check_tone(tone)
        reference = detached(as_floating("reference", reference))
        self._reference_layout = Layout.of("reference", reference.shape, axis)
        pixel_weights = None if weights is None else PixelWeights.of(weights, self._reference_layout)
        if pixel_weights is not None and not self.takes_weights:
            require_mask(type(self).__name__, pixel_weights)
        self._settings = PixelSettings(axis, policy, tone, pixel_weights, check_exposure(exposure))
        if policy == "raise":
            require_finite("reference", _visible(reference, pixel_weights, self._reference_layout), axis)
        self._reference = namespace(reference).asarray(reference, copy=True)
        self._prepared: dict[tuple[Any, ...], PreparedObjective[KeyT]] = {}

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles prepare their reference again.
        return {**self.__dict__, "_prepared": {}}

    def __repr__(self) -> str:
        return summary_line(type(self).__name__, self._facts())

    def _repr_html_(self) -> str:
        return objective_html(type(self).__name__, self._facts(), self._reference, self.channel_axis)

    def _facts(self) -> dict[str, str]:
        """Return the facts that ``repr`` shows; subclasses add their own."""
        weights = None if self.weights is None else self.weights.shape
        return facts_of_reference(self._reference.shape, self._reference.dtype) | facts_of_options(
            self.channel_axis, self.nan_policy, self.tone, weights, self.exposure
        )

    @property
    def reference(self) -> Array:
        """The reference in its own library and dtype."""
        return self._reference

    @property
    def channel_axis(self) -> int | None:
        """Axis of the channels."""
        return self._settings.channel_axis

    @property
    def nan_policy(self) -> NanPolicy:
        """Treatment of pixels that are not finite."""
        return self._settings.nan_policy

    @property
    def tone(self) -> LogTone | None:
        """The tone curve that image and reference pass."""
        return self._settings.tone

    @property
    def exposure(self) -> Exposure:
        """Treatment of the exposure of the reference relative to the image."""
        return self._settings.exposure

    @property
    def weights(self) -> Host | None:
        """Weight of each pixel, shape (*batch, H, W), float64; None if all count alike."""
        return None if self._settings.weights is None else self._settings.weights.values

    def value(self, image: Array, *, weights: Array | None = None) -> Array:
        """Return the value at `image`.

        Parameters
        ----------
        image : array, shape (*batch, H, W, C)
            Real floating point, of any library of the array API standard.
        weights : array, shape (H, W) or the image's shape without channels, optional
            Weight of each pixel of this image, such as the mask of the pixels that a warp covers. The weights of the
            reference are multiplied by them, so a pixel that either image lacks counts in neither histogram. The value
            is 0 where all weights are 0. The gradient takes weights as constants.

        Returns
        -------
        array, shape ()
            Of the image's library, dtype and device.

        Raises
        ------
        ImageTypeError, ImageError
            If the type or shape does not fit the reference, or `weights` do not fit the image or are negative.
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a pixel is NaN or infinite.
        """
        terms, _ = self._evaluate(image, weights, gradient=False)
        return narrowed(total(terms), image)

    def value_and_grad(self, image: Array, *, weights: Array | None = None) -> tuple[Array, Array]:
        """Return the value at `image` and its gradient, an array like `image`. Arguments as in :meth:`value`."""
        # The gradient is analytic; a framework that recorded the operations would only waste time and memory.
        terms, gradient = self._evaluate(detached(image), weights, gradient=True)
        return narrowed(total(terms), image), narrowed(gradient, image)

    def terms(self, image: Array, *, weights: Array | None = None) -> dict[KeyT, Array]:
        """Return the terms of the value, which sum to it. Arguments as in :meth:`value`."""
        terms, _ = self._evaluate(image, weights, gradient=False)
        return {key: narrowed(term, image) for key, term in terms.items()}

    def exposure_of(self, image: Array, *, weights: Array | None = None) -> LinearExposure:
        """Return the exposure of the reference relative to an image that is nearly aligned.

        Gain and offset of each channel, of shape (N, 1, 1), by the regression of ``exposure="regressed"`` whatever the
        objective's own exposure is. Arguments as in :meth:`value`.
        """
        image = widened(as_floating("image", image))
        prepared = self._prepare_call(image, weights)
        backend, exposure = prepared.backend, prepared.pipeline.exposure_of(prepared.backend.to_backend(image))
        return LinearExposure(*(backend.to_library(part, image) for part in (exposure.gain, exposure.offset)))

    def compared_planes(self, image: Array) -> tuple[Array, Array, Array]:
        """Return the planes of image and reference that are compared, and their weights, shape (N, H, W) each.

        One plane for each channel of each image of the batch, under the exposure of the reference, the tone curve,
        colours and bounds. Arguments as in :meth:`value`.
        """
        image = widened(as_floating("image", image))
        prepared = self._prepare_call(image, None)
        pipeline, backend = prepared.pipeline, prepared.backend
        pixels = pipeline.forward(backend.to_backend(image))
        weights = pipeline.counted_weights(pixels.planes, pixels.visible)
        if weights is None:
            weights = namespace(pixels.planes).ones_like(pixels.planes)
        planes, reference, weights = (
            backend.to_library(array, image) for array in (pixels.planes, pipeline.reference, weights)
        )
        return planes, reference, weights

    @abc.abstractmethod
    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[KeyT]:
        """Return the comparison with a reference; called once for each kind of image, for authors of an objective.

        Layouts, batches, dtypes, pixels that are not finite, masks and the tone curve are handled by the pipeline.
        """

    def compare_weighted(self, prepared: PlaneComparison[KeyT], reference: ReferencePlanes) -> PlaneComparison[KeyT]:
        """Return a comparison with other weights, from a prepared comparison with the same planes of the reference.

        Called for each image that comes with weights, if the objective takes weights. By default
        :meth:`compare_with` prepares everything again; authors of an objective may do better.
        """
        del prepared
        return self.compare_with(reference)

    def _evaluate(
        self, image: Array, weights: Array | None, *, gradient: bool
    ) -> tuple[dict[KeyT, Array], Array | None]:
        image = widened(as_floating("image", image))
        return self._prepare_call(image, weights).evaluate(image, gradient=gradient)

    def _prepare_call(self, image: Array, weights: Array | None) -> PreparedObjective[KeyT]:
        """Return the objective prepared for images like `image`, and for its weights."""
        compiles = self.runs_on_numba and not (weights is not None and is_traced(weights))
        backend = choose_backend(image) if compiles else ARRAY_API
        if weights is None:
            return self._prepare(image, backend)
        prepared = self._prepare(image, backend, weighted=True)
        call_weights = CallWeights.of(weights, prepared.pipeline.layout, backend.to_backend(image))
        if not self.takes_weights:
            require_mask(type(self).__name__, call_weights)
        pipeline, comparison = prepared.pipeline.weighted(call_weights), prepared.comparison
        if self.takes_weights:
            reference = ReferencePlanes(pipeline.reference, pipeline.weights, backend)
            comparison = self.compare_weighted(comparison, reference)
        return PreparedObjective(backend, pipeline, comparison)

    def _prepare(self, image: Array, backend: Backend, *, weighted: bool = False) -> PreparedObjective[KeyT]:
        """Return the objective prepared for images like `image`; `weighted` if each comes with weights."""
        layout = Layout.of("image", image.shape, self.channel_axis)
        weighted = weighted and self.takes_weights and self._settings.weights is None
        image_kind = (library_name(image), str(image.dtype), str(device(image)), layout.shape, backend, weighted)
        prepared = self._prepared.get(image_kind)
        if prepared is None:
            reference = reference_like("reference", self._reference, image)
            planes = layout.broadcast_planes(reference, self._reference_layout)
            pipeline = PixelPipeline.of(self._settings, layout, backend.to_backend(planes))
            weights = pipeline.weights if self.takes_weights else None
            if weighted:
                weights = namespace(pipeline.reference).ones_like(pipeline.reference)
            comparison = self.compare_with(ReferencePlanes(pipeline.reference, weights, backend))
            prepared = PreparedObjective(backend, pipeline, comparison)
            # Arrays that JAX makes while it traces are invalid once the trace has ended.
            if not is_traced(namespace(pipeline.reference).zeros(())):
                # A new dict each time, as other threads may be reading the old one.
                recent = list(self._prepared.items())[1 - MAX_PREPARED_KINDS :]
                self._prepared = dict([*recent, (image_kind, prepared)])
        return prepared


def _visible(reference: Array, weights: PixelWeights | None, layout: Layout) -> Array:
    """Return a reference with 0 in the pixels of weight 0, which may hold anything."""
    if weights is None or not weights.has_zeros:
        return reference
    planes = layout.to_planes(reference)
    xp = namespace(planes)
    return layout.to_image(xp.where(weights.planes(layout, planes) > 0.0, planes, xp.zeros_like(planes)))


def reference_like(name: str, reference: Array, image: Array) -> Array:
    """Return a reference in the library and dtype of `image`.

    Raises
    ------
    ImageTypeError
        If it is of another library, and not of NumPy, or on another device.
    """
    if is_numpy_array(reference):
        return from_numpy(reference, image)
    if library_name(reference) != library_name(image):
        msg = (
            f"`image` is an array of {library_name(image)}, `{name}` of {library_name(reference)}; "
            f"pass `{name}` as NumPy to serve every library"
        )
        raise ImageTypeError(msg)
    if not (is_traced(image) or is_traced(reference)) and device(reference) != device(image):
        msg = f"`image` is on device {device(image)}, `{name}` on {device(reference)}"
        raise ImageTypeError(msg)
    return namespace(image).astype(reference, image.dtype)


def total(terms: Mapping[Any, Array]) -> Array:
    """Return the sum of the terms of a value."""
    value, *remaining = terms.values()
    for term in remaining:
        value = value + term
    return value

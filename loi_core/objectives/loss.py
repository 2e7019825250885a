"""The loss of an image and a target, both passed to the call: nothing is kept of either."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from loi_core.errors import OptionError
from loi_core.method.dispatch import ARRAY_API, Backend, choose_backend
from loi_core.method.planner import make_plan
from loi_core.method.scales import ScaleSpace
from loi_core.objectives.base import reference_like, total
from loi_core.objectives.evaluation import PreparedObjective, ReferencePlanes
from loi_core.objectives.loi import ScaleComparison, ScaleKey, check_scales, default_scales, gradient_tolerance
from loi_core.pixels.colours import CHANNELS, Colours, check_colours
from loi_core.pixels.exposure import Exposure, check_exposure
from loi_core.pixels.layout import Layout, check_channel_axis
from loi_core.pixels.nonfinite import NanPolicy, check_nan_policy, require_finite
from loi_core.pixels.pipeline import PixelPipeline, PixelSettings
from loi_core.pixels.target import Target, image_and_weights
from loi_core.pixels.tone_curve import LogTone, check_tone
from loi_core.pixels.weights import CallWeights, check_call_weights, weight_planes
from loi_core.support.arrays import (
    Array,
    as_floating,
    detached,
    device,
    epsilon,
    held,
    is_traced,
    namespace,
    narrowed,
    widened,
)
from loi_core.support.keywords import suggest_keywords
from loi_core.support.wording import shown

__all__ = ["LossSettings", "Reduction", "loi_loss", "reduced"]

Reduction = Literal["mean", "sum", "none"]


@suggest_keywords
def loi_loss(
    image: Array,
    target: Target | Array,
    scales: ScaleSpace | None = None,
    accuracy: str | float = "exact",
    *,
    channel_axis: int | None = -1,
    nan_policy: NanPolicy = "raise",
    tone: LogTone | None = None,
    weights: Array | None = None,
    exposure: Exposure = "given",
    colours: Colours = "channels",
    reduction: Reduction = "mean",
) -> Array:
    """Return the distance between the locally orderless images of an image and a target.

    For gradients, use ``loi_torch.loi_loss``, ``loi_jax.loi_loss`` or ``loi_mitsuba.loi_loss`` under automatic
    differentiation, or ``LOIObjective.value_and_grad``, which prepares a target once for many images.

    Parameters
    ----------
    image : array, shape (*batch, H, W, C)
        Real floating point, of any library of the array API standard.
    target : array or Target, shape (*batch, H, W, C)
        The image to match, of the library of `image` or of NumPy, or the result of :func:`read_target`. Batch axes of
        length 1, and batch axes that it lacks, are repeated.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy, channel_axis, nan_policy, tone, exposure, colours
        See :class:`LOIObjective`.
    weights : array, shape (H, W) or the image's shape without channels, optional
        Weight of each pixel, 0 or more, such as the mask of the pixels to compare. Pixels of weight 0 are treated as
        equal to the target, whatever they hold. The value is 0 where all weights are 0.
    reduction : {"mean", "sum", "none"}
        The mean or the sum over the images of a batch, or one value for each image.

    Returns
    -------
    array, shape (), or the shape of the batch for ``reduction="none"``
        Of the image's library, dtype and device.

    Raises
    ------
    ImageTypeError, ImageError
        If the type or shape of `image`, `target` or `weights` does not fit, or a weight is negative.
    NonFiniteImageError
        Under ``nan_policy="raise"``, if a pixel of either image is NaN or infinite.
    LoiError
        As :class:`LOIObjective`, for the other arguments.

    Examples
    --------
    >>> import numpy as np
    >>> target = np.zeros((2, 32, 32, 1)); target[:, 20:24, 20:24] = 1.0
    >>> image = np.zeros((2, 32, 32, 1)); image[:, 4:8, 4:8] = 1.0
    >>> loi_loss(image, target, reduction="none").shape
    (2,)
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
    target, weights = image_and_weights(target, weights, channel_axis)
    value: Array = reduced(LossSettings.value, settings, image, target, weights)
    return value


@dataclass(frozen=True)
class LossSettings:
    """The options of a loss, for images of any shape and library. They are hashable.

    Attributes
    ----------
    scales : ScaleSpace, optional
    tolerance : float
        Relative error of the gradient that the accuracy allows.
    pixels : PixelSettings
    reduction : {"mean", "sum", "none"}
    """

    scales: ScaleSpace | None
    tolerance: float
    pixels: PixelSettings
    reduction: Reduction

    @classmethod
    def of(
        cls,
        scales: ScaleSpace | None,
        accuracy: str | float,
        *,
        channel_axis: int | None,
        nan_policy: NanPolicy,
        tone: LogTone | None,
        exposure: Exposure,
        colours: Colours,
        reduction: Reduction,
    ) -> LossSettings:
        """Return checked settings; parameters and errors as in :func:`loi_loss`."""
        if scales is not None:
            check_scales(scales)
        pixels = PixelSettings(
            check_channel_axis(channel_axis),
            check_nan_policy(nan_policy),
            check_tone(tone),
            None,
            check_exposure(exposure),
            check_colours(colours, CHANNELS),
        )
        return cls(scales, gradient_tolerance(accuracy), pixels, _check_reduction(reduction))

    def value(self, image: Array, target: Array, weights: Array | None = None) -> Array:
        """Return the value, shape (), the mean over all images of the batch."""
        return self.evaluate(image, target, weights, gradient=False)[0]

    def evaluate(
        self,
        image: Array,
        target: Array,
        weights: Array | None = None,
        *,
        gradient: bool,
        has_values: bool = True,
        backend: Backend | None = None,
    ) -> tuple[Array, Array | None]:
        """Return the value, the mean over all images of the batch, and its gradient, None unless it is requested.

        Parameters
        ----------
        image, target, weights : array
            As in :func:`loi_loss`. Target and weights are constants.
        gradient : bool
            Whether to compute the gradient with respect to the image.
        has_values : bool
            Whether values may be read. JAX traces arrays without values, and reading them from a GPU would wait for it.
            Without, all arrays are of one library and device, and value and gradient are NaN where images or weights
            would raise an error.
        backend : Backend, optional
            Implementation of the comparison; by default the fastest that is known to the core.
        """
        array = widened(as_floating("image", detached(image) if gradient else image))
        target = widened(held(as_floating("target", target)))
        if backend is None:
            backend = ARRAY_API if is_traced(target) or is_traced(weights) else choose_backend(array)
        prepared = self._prepare(array, target, weights, backend, has_values=has_values)
        terms, slope = prepared.evaluate(array, gradient=gradient, check_finite=has_values)
        value = total(terms)
        if not has_values:
            poison = self._poison(array, target, weights)
            value, slope = value + poison, None if slope is None else slope + poison
        return narrowed(value, image), None if slope is None else narrowed(slope, image)

    def _poison(self, image: Array, target: Array, weights: Array | None) -> Array:
        """Return 0 in the dtype of `image`, or NaN if a compared pixel is not finite or a weight is not allowed."""
        xp = namespace(image)
        layout = Layout.of("image", image.shape, self.pixels.channel_axis)
        is_valid = xp.ones((), dtype=xp.bool, device=device(image))
        seen = None
        if weights is not None:
            seen = weight_planes(weights, layout) > 0.0
            is_valid = is_valid & xp.all(xp.isfinite(weights) & (weights >= 0.0))
        if self.pixels.nan_policy == "raise":
            target_layout = Layout.of("target", target.shape, self.pixels.channel_axis)
            for planes in (layout.to_planes(image), layout.broadcast_planes(target, target_layout)):
                finite = xp.isfinite(planes)
                is_valid = is_valid & xp.all(finite if seen is None else finite | ~seen)
        zero = xp.zeros((), dtype=image.dtype, device=device(image))
        return xp.where(is_valid, zero, zero + math.nan)

    def layouts(self, image: Array, target: Array, weights: Array | None) -> tuple[Layout, Layout]:
        """Return the layouts of image and target. Raise an error if they, or weights, do not fit."""
        axis = self.pixels.channel_axis
        layout, target_layout = Layout.of("image", image.shape, axis), Layout.of("target", target.shape, axis)
        layout.require_fit(target_layout)
        check_colours(self.pixels.colours, None if axis is None else layout.planes_shape[-3])
        if weights is not None:
            check_call_weights(weights, layout)
        return layout, target_layout

    def _prepare(
        self, image: Array, target: Array, weights: Array | None, backend: Backend, *, has_values: bool
    ) -> PreparedObjective[ScaleKey]:
        """Return the comparison of images of one kind with `target`."""
        layout, target_layout = self.layouts(image, target, weights)
        scales = self.scales
        if scales is None:
            scales = default_scales(layout.height, layout.width, self.pixels.colours)
        planes = backend.to_backend(layout.broadcast_planes(reference_like("target", target, image), target_layout))
        call = None
        if weights is not None:
            call = CallWeights.of(weights, layout, backend.to_backend(image), has_values=has_values)
        if has_values and self.pixels.nan_policy == "raise":
            visible = target
            if call is not None:
                visible = layout.to_image(namespace(planes).where(call.planes > 0.0, planes, call.planes))
            require_finite("target", visible, self.pixels.channel_axis)
        pipeline = PixelPipeline.of(replace(self.pixels, intensity_range=scales.intensity_range), layout, planes, call)
        weighted = call is not None
        plan = make_plan(
            scales, layout.height, layout.width, tolerance=self.tolerance, eps=epsilon(planes), weighted=weighted
        )
        comparison = ScaleComparison(scales, plan, ReferencePlanes(pipeline.reference, pipeline.weights, backend))
        return PreparedObjective(backend, pipeline, comparison)


def reduced(
    loss: Callable[[LossSettings, Array, Array, Array | None], Array],
    settings: LossSettings,
    image: Array,
    target: Array,
    weights: Array | None,
    *,
    each: Callable[..., Array] | None = None,
) -> Array:
    """Return the losses of the images of a batch under the reduction of `settings`.

    Parameters
    ----------
    loss : callable
        ``loss(settings, image, target, weights)`` is the mean over the images of a batch.
    settings : LossSettings
    image, target, weights : array
        As in :func:`loi_loss`.
    each : callable, optional
        ``each(loss)(images, targets, weights)`` is the stack of the losses of the entries of the first axis, as
        ``jax.vmap``; by default a loop.
    """
    if settings.reduction == "mean":
        return loss(settings, image, target, weights)
    layout, target_layout = settings.layouts(as_floating("image", image), as_floating("target", target), weights)
    core = 2 if layout.channel_axis is None else 3
    *batch, height, width = layout.planes_shape[: len(layout.shape) - core] + layout.planes_shape[-2:]
    if settings.reduction == "sum":
        return loss(settings, image, target, weights) * math.prod(batch)
    single = layout.planes_shape[len(batch) :]
    arrays = [
        namespace(planes).reshape(planes, (-1, *single))
        for planes in (layout.to_planes(image), layout.broadcast_planes(target, target_layout))
    ]
    if weights is not None:
        xp = namespace(weights)
        arrays.append(xp.reshape(xp.broadcast_to(weights, (*batch, height, width)), (-1, height, width)))
    channel_axis = None if layout.channel_axis is None else -3
    settings = replace(settings, pixels=replace(settings.pixels, channel_axis=channel_axis), reduction="mean")

    def value(image: Array, target: Array, weights: Array | None = None) -> Array:
        return loss(settings, image, target, weights)

    values = _loop(value, *arrays) if each is None else each(value)(*arrays)
    return namespace(values).reshape(values, tuple(batch))


def _loop(value: Callable[..., Array], *arrays: Array) -> Array:
    entries = zip(*(namespace(array).unstack(array) for array in arrays), strict=True)
    return namespace(arrays[0]).stack([value(*entry) for entry in entries])


def _check_reduction(reduction: Any) -> Reduction:
    for name in get_args(Reduction):
        if isinstance(reduction, str) and reduction == name:
            checked: Reduction = name
            return checked
    msg = f"`reduction` must be one of {', '.join(map(repr, get_args(Reduction)))}, got {shown(reduction)}"
    raise OptionError(msg)

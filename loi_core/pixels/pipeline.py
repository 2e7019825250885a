"""The pixel pipeline: an image becomes the planes that are compared, and their cotangent becomes the image's gradient.

The steps, in order: layout, masking of pixels, exposure, tone curve, differences of colours, range of
intensities. Each step has a pullback beside it; :meth:`PixelPipeline.pullback` applies them in reverse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loi_core.pixels.bounds import IntensityRange, warn_if_out_of_range
from loi_core.pixels.colours import LARGEST_FACTOR, Colours, differences, differences_pullback
from loi_core.pixels.exposure import Exposure, LinearExposure, estimate_exposure
from loi_core.pixels.layout import Layout
from loi_core.pixels.nonfinite import NanPolicy, require_finite
from loi_core.pixels.tone_curve import LogTone
from loi_core.pixels.weights import CallWeights, PixelWeights
from loi_core.support.arrays import Array, namespace, to_numpy

__all__ = ["PixelPass", "PixelPipeline", "PixelSettings"]


@dataclass(frozen=True)
class PixelSettings:
    """Options of the pipeline, for images of any shape and library.

    Attributes
    ----------
    channel_axis : int or None
    nan_policy : {"raise", "mask"}
    tone : LogTone, optional
    weights : PixelWeights, optional
    exposure : {"given", "matched", "regressed", "detected"}
    colours : {"channels", "differences"}
    intensity_range : IntensityRange, optional
        The map of intensities to the range that is compared; None leaves them.
    """

    channel_axis: int | None
    nan_policy: NanPolicy
    tone: LogTone | None
    weights: PixelWeights | None
    exposure: Exposure = "given"
    colours: Colours = "channels"
    intensity_range: IntensityRange | None = None

    def apply_tone(self, planes: Array) -> Array:
        """Return planes, shape (N, H, W), after the tone curve."""
        return planes if self.tone is None else self.tone.apply(planes)

    def apply_colours(self, planes: Array) -> Array:
        """Return planes, shape (N, H, W), or their differences of colours around the middle of the bounds."""
        if self.colours == "channels":
            return planes
        limits = self.intensity_range or IntensityRange(0.0, 1.0)
        return differences(planes, 0.5 * (limits.low + limits.high))

    def compress(self, planes: Array) -> Array:
        """Return planes, shape (N, H, W), mapped to the range of intensities."""
        return planes if self.intensity_range is None else self.intensity_range.apply(planes)


@dataclass(frozen=True)
class PixelPass:
    """One image in the pipeline: the result, and the intermediate planes that the pullback needs.

    Attributes
    ----------
    planes : array, shape (N, H, W)
        The planes to compare.
    uncompressed : array, shape (N, H, W)
        The same before the map to the range of intensities.
    exposed : array, shape (N, H, W)
        The image's planes under the exposure of the reference, before the tone curve; 0 in pixels that are not visible
        if no exposure is estimated.
    exposure : LinearExposure, optional
        The estimated exposure; None if none is estimated.
    visible : array of bool, shape (N, H, W), optional
        The pixels that are compared; None if all are.
    """

    planes: Array
    uncompressed: Array
    exposed: Array
    exposure: LinearExposure | None
    visible: Array | None


@dataclass(frozen=True, eq=False)
class PixelPipeline:
    """Map images of one shape, library, dtype and device to planes, one for each channel of each image of the batch.

    Attributes
    ----------
    settings : PixelSettings
    layout : Layout
        Of the images.
    reference : array, shape (N, H, W)
        The reference's planes, ready to compare.
    masked_reference : array, shape (N, H, W)
        The reference's planes before the tone curve, finite.
    toned_reference : array, shape (N, H, W)
        The same before colours and the range of intensities; replaces pixels of the image that are not visible.
    visible : array of bool, shape (N, H, W), optional
        The pixels of the reference that are compared; None if all are.
    weights : array, shape (N, H, W), optional
        Weights in [0, 1]; None if all pixels count alike.
    largest_weight : float or array, shape ()
        The factor of the value and of the gradient that scaling the weights to [0, 1] leaves out.
    """

    settings: PixelSettings
    layout: Layout
    reference: Array
    masked_reference: Array
    toned_reference: Array
    visible: Array | None
    weights: Array | None
    largest_weight: float | Array = 1.0

    @classmethod
    def of(
        cls, settings: PixelSettings, layout: Layout, reference: Array, call: CallWeights | None = None
    ) -> PixelPipeline:
        """Prepare the pipeline for a reference, planes of shape (N, H, W) in the library and dtype of the images.

        Weights of a `call` take the place of weights in the settings.
        """
        xp = namespace(reference)
        weights = None if settings.weights is None else settings.weights.planes(layout, reference)
        largest: float | Array = 1.0 if settings.weights is None else settings.weights.largest
        visible = None
        if weights is not None and settings.weights is not None and settings.weights.has_zeros:
            visible = weights > 0.0
        if call is not None:
            weights, largest, visible = call.planes, call.largest, call.planes > 0.0
        if settings.nan_policy == "mask":
            visible = xp.isfinite(reference) if visible is None else xp.isfinite(reference) & visible
        if visible is not None:
            # An invisible pixel keeps its reference value unless the value is not finite.
            reference = xp.where(xp.isfinite(reference), reference, xp.zeros_like(reference))
        toned = settings.apply_tone(reference)
        uncompressed = settings.apply_colours(toned)
        limits = settings.intensity_range
        if limits is not None:
            warn_if_out_of_range(uncompressed, weights, (limits.low, limits.high))
        return cls(settings, layout, settings.compress(uncompressed), reference, toned, visible, weights, largest)

    def weighted(self, weights: CallWeights) -> PixelPipeline:
        """Return the pipeline for an image with weights, which multiply the weights of the reference."""
        planes, largest = weights.planes, weights.largest
        if self.weights is not None:
            planes, largest = planes * self.weights, largest * self.largest_weight
            xp = namespace(planes)
            shared = xp.max(planes)
            planes = planes / xp.where(shared > 0.0, shared, xp.ones_like(shared))
            largest = largest * shared
        visible = planes > 0.0 if self.visible is None else (planes > 0.0) & self.visible
        return replace(self, visible=visible, weights=planes, largest_weight=largest)

    def forward(self, image: Array, *, check_finite: bool = True) -> PixelPass:
        """Return the planes of an image of the pipeline's shape, library, dtype and device.

        Raises
        ------
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a visible pixel is not finite; not if `check_finite` is False.
        """
        settings, visible = self.settings, self.visible
        planes = self.layout.to_planes(image)
        xp = namespace(planes)
        if settings.nan_policy == "mask":
            visible = xp.isfinite(planes) if visible is None else xp.isfinite(planes) & visible
        if visible is not None:
            planes = xp.where(visible, planes, xp.zeros_like(planes))  # no NaN reaches a curve or its derivative
        if settings.nan_policy == "raise" and check_finite:
            masked = image if visible is None else self.layout.to_image(planes)
            require_finite("image", masked, settings.channel_axis)
        exposure = self.estimate_exposure(planes, visible)
        if exposure is not None:
            planes = exposure.apply(planes)
        toned = settings.apply_tone(planes)
        if visible is not None:
            toned = xp.where(visible, toned, self.toned_reference)
        uncompressed = settings.apply_colours(toned)
        return PixelPass(settings.compress(uncompressed), uncompressed, planes, exposure, visible)

    def exposure_of(self, image: Array) -> LinearExposure:
        """Return the exposure of the reference relative to an image, by regression."""
        xp, planes = namespace(image), self.layout.to_planes(image)
        visible = xp.isfinite(planes) if self.visible is None else xp.isfinite(planes) & self.visible
        planes = xp.where(visible, planes, xp.zeros_like(planes))
        return estimate_exposure(planes, self.masked_reference, self.counted_weights(planes, visible), "regressed")

    def estimate_exposure(self, planes: Array, visible: Array | None) -> LinearExposure | None:
        """Return the exposure of the reference relative to masked planes, shape (N, H, W); None if it is given."""
        if self.settings.exposure == "given":
            return None
        weights = self.counted_weights(planes, visible)
        return estimate_exposure(planes, self.masked_reference, weights, self.settings.exposure)

    def counted_weights(self, planes: Array, visible: Array | None) -> Array | None:
        """Return the weights of planes, shape (N, H, W), 0 where they are not visible; None if all count alike."""
        if visible is None:
            return self.weights
        seen = namespace(planes).astype(visible, planes.dtype)
        return seen if self.weights is None else seen * self.weights

    def pullback(self, pixels: PixelPass, cotangent: Array) -> Array:
        """Return the gradient with respect to the image, from the cotangent of ``pixels.planes``, shape (N, H, W)."""
        settings = self.settings
        if settings.intensity_range is not None:
            cotangent = settings.intensity_range.pullback(pixels.uncompressed, cotangent)
        if settings.colours == "differences":
            cotangent = differences_pullback(cotangent)
        if settings.tone is not None:
            cotangent = settings.tone.pullback(pixels.exposed, cotangent)
        if pixels.visible is not None:
            xp = namespace(cotangent)
            cotangent = xp.where(pixels.visible, cotangent, xp.zeros_like(cotangent))
        if pixels.exposure is not None:
            cotangent = pixels.exposure.pullback(cotangent)
        return self.layout.to_image(cotangent)

    def pullback_error(self, pixels: PixelPass, error: float) -> float:
        """Return an upper bound on the 2-norm error of the gradient, from the error of the planes' cotangent."""
        settings = self.settings
        if settings.colours == "differences":
            error *= LARGEST_FACTOR
        if settings.tone is not None:
            slopes = settings.tone.pullback(pixels.exposed, namespace(pixels.exposed).ones_like(pixels.exposed))
            error *= float(np.max(to_numpy(slopes)))
        if pixels.exposure is not None:
            error *= float(np.max(to_numpy(pixels.exposure.gain)))
        return error

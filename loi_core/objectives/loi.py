"""The objective of the paper: local histograms, compared at three scales."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Final

from loi_core.errors import OptionError, ScaleError
from loi_core.method.comparison import Comparison, ScaleKey
from loi_core.method.compiled import available
from loi_core.method.plan import Plan
from loi_core.method.planner import make_plan
from loi_core.method.sampling_error import estimated_error
from loi_core.method.scales import Boundary, ScaleSpace
from loi_core.objectives.base import ImageObjective
from loi_core.objectives.evaluation import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.objectives.facts import facts_of_scales
from loi_core.pixels.bounds import warn_if_indistinct
from loi_core.pixels.colours import Colours, check_colours
from loi_core.pixels.exposure import Exposure
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.target import Target
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, epsilon, values_may_decide, widened
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = [
    "ACCURACIES",
    "LOIObjective",
    "ScaleKey",
    "accuracy_name",
    "default_scales",
    "gradient_tolerance",
    "gradients_by_scale",
]

ACCURACIES: Final = {"exact": 0.0, "balanced": 1e-2, "fast": 5e-2}
"""Relative error of the gradient that each accuracy allows."""


def gradient_tolerance(accuracy: str | float) -> float:
    """Return the relative gradient error that `accuracy` allows: "exact" 0, "balanced" 1e-2, "fast" 5e-2.

    Raises
    ------
    OptionError
        For another name, or a number outside [0, 1).
    """
    if isinstance(accuracy, str) and accuracy in ACCURACIES:
        return ACCURACIES[accuracy]
    number = real_number(accuracy)
    if 0.0 <= number < 1.0:
        return number
    names = ", ".join(map(repr, ACCURACIES))
    msg = f"`accuracy` must be one of {names}, or a relative error in [0, 1), got {shown(accuracy)}"
    raise OptionError(msg)


def accuracy_name(tolerance: float) -> str:
    """Return the name of the accuracy with this relative gradient error, or the number if it has no name."""
    return next((name for name, error in ACCURACIES.items() if error == tolerance), f"{tolerance:g}")


def check_scales(scales: object) -> ScaleSpace:
    """Return `scales`, or raise ScaleError if they are of another type; warn if they distinguish no intensities."""
    if not isinstance(scales, ScaleSpace):
        msg = f"`scales` must be a ScaleSpace, got {type(scales).__name__}"
        raise ScaleError(msg)
    warn_if_indistinct(min(scales.beta), scales.bounds)
    return scales


def default_scales(
    height: int,
    width: int,
    colours: Colours = "channels",
    *,
    bounds: tuple[float, float] = (0.0, 1.0),
    boundary: Boundary = "reflect",
) -> ScaleSpace:
    """Return :meth:`ScaleSpace.for_image`, with half its beta for differences of colours, which are halved."""
    scales = ScaleSpace.for_image(height, width, bounds=bounds, boundary=boundary)
    return scales if colours == "channels" else replace(scales, beta=(scales.beta[0] / 2.0,))


@suggest_keywords
class LOIObjective(ImageObjective[ScaleKey]):
    """The distance between the locally orderless images of a render and a reference (eqs. 1 to 5).

    Every pixel becomes a soft histogram of the intensities around it, at inner scale sigma, tonal scale beta and
    extent alpha. Histograms are compared by the Wasserstein distance of order `p`, averaged over pixels and
    channels, and summed over scales. Unlike a difference of pixels it has a gradient where nothing overlaps.
    :mod:`loi_core.method.reference` computes it by brute force on one page; start reading there.

    Parameters
    ----------
    reference : array or Target, shape (*batch, H, W, C)
        The target. Real floating point; see :class:`ImageObjective`.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient that is allowed in exchange for time: 0, 1e-2, 5e-2, or a number; in the
        2-norm, relative to "exact". :meth:`plan` shows how it is used. Every call estimates its error from the images,
        and computes the gradient exactly if that error is too large.
    channel_axis : int or None
        Where the channels are; None for images without channels.
    nan_policy : {"raise", "mask"}
        Treatment of pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range. The scales' `bounds` and beta refer to its output.
    weights : array, shape (H, W) or that of the reference without channels, optional
        Weight of each pixel, 0 or more, also in the histograms of its neighbours; see :class:`ImageObjective`.
    exposure : {"given", "matched", "regressed", "detected"}
        Treatment of a photograph's exposure; see :class:`ImageObjective`.
    colours : {"channels", "differences"}
        "differences" compares half of red - green, green - blue and blue - red, around the middle of the bounds. White
        light on a grey surface, and shadows there, change none of them, which helps in scenes where objects of many
        colours cast shadows as they move. Grey objects are invisible. Needs three channels.

    Examples
    --------
    >>> import numpy as np
    >>> reference = np.zeros((32, 32, 1)); reference[20:24, 20:24] = 1.0
    >>> image = np.zeros((32, 32, 1)); image[4:8, 4:8] = 1.0
    >>> objective = LOIObjective(reference, ScaleSpace(sigma=1, alpha=(1, 5), beta=0.125))
    >>> value, gradient = objective.value_and_grad(image)
    >>> gradient.shape
    (32, 32, 1)
    """

    takes_weights: ClassVar[bool] = True
    runs_on_numba: ClassVar[bool] = True

    def __init__(
        self,
        reference: Target | Array,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
        exposure: Exposure = "given",
        colours: Colours = "channels",
    ) -> None:
        super().__init__(
            reference,
            channel_axis=channel_axis,
            nan_policy=nan_policy,
            tone=tone,
            weights=weights,
            exposure=exposure,
        )
        layout = self._reference_layout
        colours = check_colours(colours, None if layout.channel_axis is None else layout.planes_shape[-3])
        if scales is None:
            scales = default_scales(*self.size, colours)
        self._scales = check_scales(scales)
        self._tolerance = gradient_tolerance(accuracy)
        self._settings = replace(self._settings, colours=colours, intensity_range=scales.intensity_range)

    def _facts(self) -> dict[str, str]:
        facts = super()._facts()
        accuracy = {"accuracy": accuracy_name(self._tolerance)}
        colours = {} if self.colours == "channels" else {"colours": self.colours}
        return {"reference": facts.pop("reference")} | facts_of_scales(self._scales) | accuracy | facts | colours

    @property
    def scales(self) -> ScaleSpace:
        """The scales that are compared."""
        return self._scales

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the reference, in pixels."""
        return self._reference_layout.height, self._reference_layout.width

    @property
    def has_default_scales(self) -> bool:
        """Whether the scales are the default ones, with any bounds, passed explicitly or not."""
        scales = self._scales
        return scales == default_scales(*self.size, self.colours, bounds=scales.bounds, boundary=scales.boundary)

    def with_scales(self, scales: ScaleSpace) -> LOIObjective:
        """Return the same objective at other scales."""
        return self._like(self._reference, scales, self.exposure)

    def with_reference(self, reference: Array) -> LOIObjective:
        """Return the same objective with another reference."""
        return self._like(reference, self._scales, self.exposure)

    def with_exposure(self, exposure: Exposure) -> LOIObjective:
        """Return the same objective with another treatment of the exposure."""
        return self._like(self._reference, self._scales, exposure)

    def _like(self, reference: Array, scales: ScaleSpace, exposure: Exposure) -> LOIObjective:
        return LOIObjective(
            reference,
            scales,
            self._tolerance,
            channel_axis=self.channel_axis,
            nan_policy=self.nan_policy,
            tone=self.tone,
            weights=self.weights,
            exposure=exposure,
            colours=self.colours,
        )

    @property
    def colours(self) -> Colours:
        """The compared quantities of colours: channels, or their differences."""
        return self._settings.colours

    @property
    def tolerance(self) -> float:
        """The relative error of the gradient that `accuracy` allows."""
        return self._tolerance

    def terms(self, image: Array, *, weights: Array | None = None) -> dict[ScaleKey, Array]:
        """Return the term of each scale, ``{(alpha, beta, sigma): 0-d array}``; they sum to the value."""
        return super().terms(image, weights=weights)

    def plan(self, height: int | None = None, width: int | None = None, *, eps: float | None = None) -> Plan:
        """Return the operations of each scale, with their cost and error; ``print`` shows them.

        Parameters
        ----------
        height, width : int, optional
            Size of the images; the reference's by default.
        eps : float, optional
            Machine epsilon of the images' dtype; the reference's by default.
        """
        layout = self._reference_layout
        size = layout.height if height is None else height, layout.width if width is None else width
        eps = epsilon(widened(self._reference)) if eps is None else eps
        plan = self._plan(size, eps, weighted=self._settings.weights is not None)
        return replace(plan, compiled=available())

    def _plan(self, size: tuple[int, ...], eps: float, *, weighted: bool) -> Plan:
        return make_plan(self._scales, *size, tolerance=self._tolerance, eps=eps, weighted=weighted)

    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[ScaleKey]:
        """See :class:`ImageObjective`."""
        planes = reference.planes
        plan = self._plan(planes.shape[-2:], epsilon(planes), weighted=reference.weights is not None)
        comparison = ScaleComparison(self._scales, plan, reference)
        # Prepared now and not at the first comparison, because JAX may be tracing there.
        comparison.choose(planes)
        return comparison

    def compare_weighted(
        self, prepared: PlaneComparison[ScaleKey], reference: ReferencePlanes
    ) -> PlaneComparison[ScaleKey]:
        """See :class:`ImageObjective`. Weights multiply differences, so one prepared reference serves all."""
        if isinstance(prepared, ScaleComparison) and reference.weights is not None:
            return _WeightedScaleComparison(prepared, reference.weights)
        return self.compare_with(reference)


class ScaleComparison(PlaneComparison[ScaleKey]):
    """Comparison of local histograms: by the plan, and exactly where the plan's error is too large."""

    def __init__(self, scales: ScaleSpace, plan: Plan, reference: ReferencePlanes) -> None:
        self.tolerance = plan.tolerance
        self._scales = scales
        self._plan = plan
        self._reference = reference
        self._planned: Comparison | None = None
        self._exact: Comparison | None = None

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[ScaleKey]:
        """See :class:`PlaneComparison`."""
        return _evaluation(self.choose(planes), planes, gradient=gradient)

    def compare_exactly(self, planes: Array) -> Evaluation[ScaleKey]:
        """See :class:`PlaneComparison`."""
        return _evaluation(self.exact(), planes, gradient=True)

    def choose(self, planes: Array) -> Comparison:
        """Return the comparison by the plan; the exact one where values cannot be read, so no error can be estimated.

        Each is prepared when it is first needed, without a lock: two threads may prepare the same comparison twice, and
        a forked process never waits for a thread that it does not have.
        """
        if self.tolerance == 0.0 or not values_may_decide(planes):
            return self.exact()
        if self._planned is None:
            self._planned = self._prepared(self._plan)
        return self._planned

    def exact(self) -> Comparison:
        """Return the exact comparison."""
        if self._exact is None:
            plan, weighted = self._plan, self._reference.weights is not None
            if self.tolerance > 0.0:
                plan = make_plan(self._scales, plan.height, plan.width, tolerance=0.0, eps=plan.eps, weighted=weighted)
            self._exact = self._prepared(plan)
        return self._exact

    def _prepared(self, plan: Plan) -> Comparison:
        reference = self._reference
        return reference.backend.comparison(self._scales, plan, reference.planes, reference.weights)


class _WeightedScaleComparison(PlaneComparison[ScaleKey]):
    """A prepared comparison with other weights."""

    def __init__(self, prepared: ScaleComparison, weights: Array) -> None:
        self.tolerance = prepared.tolerance
        self._prepared = prepared
        self._weights = weights

    def compare(self, planes: Array, *, gradient: bool) -> Evaluation[ScaleKey]:
        """See :class:`PlaneComparison`."""
        return _evaluation(self._prepared.choose(planes).with_weights(self._weights), planes, gradient=gradient)

    def compare_exactly(self, planes: Array) -> Evaluation[ScaleKey]:
        """See :class:`PlaneComparison`."""
        return _evaluation(self._prepared.exact().with_weights(self._weights), planes, gradient=True)


def _evaluation(comparison: Comparison, planes: Array, *, gradient: bool) -> Evaluation[ScaleKey]:
    compared = comparison.compare(planes, gradient=gradient)
    return Evaluation(compared.terms, compared.cotangent, estimated_error(compared.sign_errors))


def gradients_by_scale(objective: LOIObjective, image: Array) -> Iterator[tuple[ScaleKey, Array]]:
    """Yield (alpha, beta, sigma) and the gradient of each scale's term; these sum to the gradient of the loss.

    Errors as in :meth:`LOIObjective.value_and_grad`.
    """
    for key in objective.scales.keys:
        alpha, beta, sigma = key
        single = objective.with_scales(replace(objective.scales, alpha=(alpha,), beta=(beta,), sigma=(sigma,)))
        yield key, single.value_and_grad(image)[1]

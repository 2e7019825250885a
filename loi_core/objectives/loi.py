"""The objective of the paper: local histograms, compared at three scales."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import ClassVar, Final

from loi_core.errors import OptionError, ScaleError
from loi_core.method.comparison import Comparison, ScaleKey
from loi_core.method.compiled import available
from loi_core.method.plan import Plan
from loi_core.method.planner import make_plan
from loi_core.method.sampling_error import error_of, is_within
from loi_core.method.scales import Boundary, ScaleSpace
from loi_core.method.ways import BY_ARRAYS, BY_LOOPS, Way, way_for
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.objectives.facts import facts_of_scales
from loi_core.pixels.bounds import clip, clip_pullback
from loi_core.pixels.colours import LARGEST_FACTOR, Colours, check_colours, differences, differences_pullback
from loi_core.pixels.nonfinite import NanPolicy
from loi_core.pixels.tone_curve import LogTone
from loi_core.support.arrays import Array, epsilon, is_numpy_array, namespace, values_may_decide, widened
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = [
    "ACCURACIES",
    "LOIObjective",
    "RangeWarning",
    "ScaleKey",
    "accuracy_name",
    "default_scales",
    "gradient_tolerance",
    "warn_if_clipped",
]

ROUNDING: Final = 1e-6  # of the bounds' distance: a reference in float32, white but for that, is not beyond them
MOST_CLIPPED: Final = 0.02  # of the reference, without a word: a lamp or two in view
ACCURACIES: Final = {"exact": 0.0, "balanced": 1e-2, "fast": 5e-2}


def gradient_tolerance(accuracy: str | float) -> float:
    """The relative gradient error that `accuracy` allows: of "exact" 0, "balanced" 1e-2, "fast" 5e-2.

    Raises
    ------
    OptionError
        For another name, or a number that is not in [0, 1).
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
    """What a relative gradient error is called by; the number if it has no name."""
    return next((name for name, one in ACCURACIES.items() if one == tolerance), f"{tolerance:g}")


def default_scales(
    height: int,
    width: int,
    colours: Colours = "channels",
    *,
    bounds: tuple[float, float] = (0.0, 1.0),
    boundary: Boundary = "reflect",
) -> ScaleSpace:
    """The scales of :meth:`ScaleSpace.for_image`; with half the beta for differences of colours, which are halved."""
    scales = ScaleSpace.for_image(height, width, bounds=bounds, boundary=boundary)
    return scales if colours == "channels" else replace(scales, beta=(scales.beta[0] / 2.0,))


class RangeWarning(UserWarning):
    """Much of a reference lies beyond the bounds of the scales, where nothing is told apart."""


class LOIObjective(ImageObjective["_Prepared", ScaleKey]):
    """The distance between the locally orderless images of a render and a reference (eqs. 1 to 5).

    Every pixel becomes a soft histogram of the intensities around it, at inner scale sigma, tonal scale beta and
    extent alpha. Histograms are compared by the Wasserstein distance of order `p`, averaged over pixels and
    channels, and summed over scales. Unlike a difference of pixels it has a gradient where nothing overlaps.
    :mod:`loi_core.method.reference` is the whole of it on one page, by brute force; start reading there.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        What the image should look like. Real floating point; see :class:`ImageObjective`.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default, with half its beta for differences of colours.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient that is allowed in exchange for time: 0, 1e-2, 5e-2, or the number
        given; in the 2-norm, beside "exact". :meth:`plan` says what is done with it. Every call estimates its error
        from the images; where that is too large, its gradient is computed exactly.
    channel_axis : int or None
        Where the channels are; None for images without channels.
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range. `bounds`, beta and the clipping of values beyond the bounds are
        those of the values that it gives.
    weights : array, shape (H, W) or that of the reference without channels, optional
        How much each pixel counts, 0 or more, and so in the histograms of its neighbours; see :class:`ImageObjective`.
    colours : {"channels", "differences"}
        "differences" compares half of red - green, green - blue and blue - red, around the middle of the bounds. White
        light on a grey surface, and shadows there, change none of them: for scenes where objects of many colours throw
        shadows as they move. What is grey is not seen. Needs three channels.

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

    def __init__(
        self,
        reference: Array,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
        colours: Colours = "channels",
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone, weights=weights)
        layout = self._reference_layout
        self._colours = check_colours(colours, None if layout.channel_axis is None else layout.planes_shape[-3])
        if scales is None:
            scales = default_scales(*self.size, self._colours)
        if not isinstance(scales, ScaleSpace):
            msg = f"`scales` must be a ScaleSpace, got {type(scales).__name__}"
            raise ScaleError(msg)
        self._scales = scales
        self._tolerance = gradient_tolerance(accuracy)

    def _facts(self) -> dict[str, str]:
        facts = super()._facts()
        accuracy = {"accuracy": accuracy_name(self._tolerance)}
        colours = {} if self._colours == "channels" else {"colours": self._colours}
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
        """Whether the scales are the default ones, with any bounds, whoever put them there."""
        scales = self._scales
        return scales == default_scales(*self.size, self._colours, bounds=scales.bounds, boundary=scales.boundary)

    def with_scales(self, scales: ScaleSpace) -> LOIObjective:
        """The same objective at other scales."""
        return self._like(self._reference, scales)

    def with_reference(self, reference: Array) -> LOIObjective:
        """The same objective with another reference."""
        return self._like(reference, self._scales)

    def _like(self, reference: Array, scales: ScaleSpace) -> LOIObjective:
        return LOIObjective(
            reference,
            scales,
            self._tolerance,
            channel_axis=self._channel_axis,
            nan_policy=self._nan_policy,
            tone=self._tone,
            weights=self.weights,
            colours=self._colours,
        )

    @property
    def colours(self) -> Colours:
        """What of the colours is compared."""
        return self._colours

    @property
    def tolerance(self) -> float:
        """The relative error of the gradient that `accuracy` allows."""
        return self._tolerance

    def terms(self, image: Array) -> dict[ScaleKey, Array]:
        """What each scale adds to the value: ``{(alpha, beta, sigma): 0-d array}``; they sum to the value."""
        return super().terms(image)

    def plan(self, height: int | None = None, width: int | None = None, *, eps: float | None = None) -> Plan:
        """What is computed for each scale, at which cost and error; ``print`` shows it.

        Parameters
        ----------
        height, width : int, optional
            Size of the images; the reference's by default.
        eps : float, optional
            Machine epsilon of the images' dtype; the reference's by default.
        """
        layout = self._reference_layout
        plan = make_plan(
            self._scales,
            layout.height if height is None else height,
            layout.width if width is None else width,
            tolerance=self._tolerance,
            eps=epsilon(widened(self._reference)) if eps is None else eps,
            weighted=self._pixel_weights is not None,
        )
        return replace(plan, compiled=available())

    def prepare_reference(self, reference: Array, weights: Array | None) -> _Prepared:
        """See :class:`ImageObjective`."""
        scales = self._scales
        reference = self._coloured(reference)
        warn_if_clipped(reference, weights, scales.bounds)
        plan = self.plan(*reference.shape[-2:], eps=epsilon(reference))
        prepared = _Prepared(scales, plan, clip(reference, *scales.bounds), weights)
        # Now, and not when it is first used: that may be where JAX traces.
        prepared.first(reference)
        return prepared

    def choose_way(self, image: Array) -> Way:
        """By compiled loops where they can, in the image's own library elsewhere."""
        return way_for(image)

    def compare_planes(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[ScaleKey]:
        """See :class:`ImageObjective`."""
        bounds = self._scales.bounds
        planes = self._coloured(planes)
        clipped = clip(planes, *bounds)
        compared = prepared.first(planes).compare(clipped, gradient=gradient)
        if not gradient:
            return Evaluation(compared.terms, None)
        error = error_of(compared.misplaced) * (1.0 if self._colours == "channels" else LARGEST_FACTOR)

        def better(norm: float, factor: float) -> Array | None:
            if is_within(error * factor, self._tolerance, norm):
                return None
            exact = prepared.exact(planes).compare(clipped, gradient=True)
            return carried_back(exact.cotangent)

        def carried_back(cotangent: Array) -> Array:
            inside = clip_pullback(planes, cotangent, *bounds)
            return inside if self._colours == "channels" else differences_pullback(inside)

        return Evaluation(compared.terms, carried_back(compared.cotangent), better if error > 0.0 else None)

    def _coloured(self, planes: Array) -> Array:
        if self._colours == "channels":
            return planes
        low, high = self._scales.bounds
        return differences(planes, 0.5 * (low + high))


class _Prepared:
    """All that depends on the reference alone, by plan and by way of comparing; what is not needed yet is not made."""

    def __init__(self, scales: ScaleSpace, plan: Plan, reference: Array, weights: Array | None) -> None:
        self._scales = scales
        self._weights = weights  # shape (N, H, W)
        self._plan = plan
        self._exact = (
            plan
            if plan.tolerance == 0.0
            else make_plan(scales, plan.height, plan.width, tolerance=0.0, eps=plan.eps, weighted=weights is not None)
        )
        self._reference = reference  # within the bounds, shape (N, H, W)
        self._made: dict[tuple[bool, Way], Comparison] = {}

    def first(self, planes: Array) -> Comparison:
        """How planes are compared at first: by the plan, if it can be checked against their values."""
        way = _way_of(planes)
        return self._get(way, planned=way is BY_LOOPS or values_may_decide(planes))

    def exact(self, planes: Array) -> Comparison:
        """How planes are compared where the plan cannot vouch for its accuracy."""
        return self._get(_way_of(planes), planned=False)

    def _get(self, way: Way, *, planned: bool) -> Comparison:
        # No lock: threads that come at once make the same twice, and a process that is forked meanwhile waits for none.
        key = planned and self._plan is not self._exact, way
        made = self._made.get(key)
        if made is None:
            plan = self._plan if key[0] else self._exact
            made = self._made[key] = way.comparison(self._scales, plan, self._reference, self._weights)
        return made


def warn_if_clipped(reference: Array, weights: Array | None, bounds: tuple[float, float]) -> None:
    """Tell of a reference that loses much to the bounds, as radiance above 1 does."""
    if not values_may_decide(reference):
        return
    low, high = bounds
    rounding = ROUNDING * (high - low)
    xp = namespace(reference)
    beyond = (reference < low - rounding) | (reference > high + rounding)
    if weights is not None:
        beyond = beyond & (weights > 0.0)
    share = float(xp.mean(xp.astype(beyond, reference.dtype)))
    if share > MOST_CLIPPED:
        least, most = float(xp.min(reference)), float(xp.max(reference))
        msg = (
            f"{share:.0%} of the reference lies beyond the scales' `bounds` ({low:g}, {high:g}) and counts as the "
            f"bound, so that what differs there is not seen; it reaches from {least:.3g} to {most:.3g}: give "
            f"ScaleSpace.for_image(height, width, bounds=...), or a `tone`"
        )
        warnings.warn(msg, RangeWarning, stacklevel=2)


def _way_of(planes: Array) -> Way:
    """The way that planes have been taken: those for the loops are of NumPy."""
    return way_for(planes) if is_numpy_array(planes) else BY_ARRAYS

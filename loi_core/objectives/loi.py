"""The objective of the paper: local histograms, compared at three scales."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from loi_core.arrays import Array, device, epsilon, is_numpy_array, namespace, widened
from loi_core.comparison import InnerComparison, ScaleKey, Terms
from loi_core.compiled import available, serves
from loi_core.errors import OptionError, ScaleError
from loi_core.messages import shown
from loi_core.nonfinite import NanPolicy
from loi_core.objectives.base import Evaluation, ImageObjective
from loi_core.plan import Plan, make_plan
from loi_core.scales import ScaleSpace
from loi_core.tonal import clip, clip_pullback
from loi_core.tone import LogTone
from loi_core.values import real_number

if TYPE_CHECKING:
    from loi_core.compiled.comparison import CompiledComparison

__all__ = ["ACCURACIES", "LOIObjective", "ScaleKey", "gradient_tolerance"]

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


class LOIObjective(ImageObjective["_Prepared", ScaleKey]):
    """The distance between the locally orderless images of a render and a reference (eqs. 1 to 5).

    Every pixel becomes a soft histogram of the intensities around it, at inner scale sigma, tonal scale beta and
    extent alpha. Histograms are compared by the Wasserstein distance of order `p`, averaged over pixels and
    channels, and summed over scales. Unlike a difference of pixels it has a gradient where nothing overlaps.

    Parameters
    ----------
    reference : array, shape (*batch, H, W, C)
        What the image should look like. Real floating point; see :class:`ImageObjective`.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default.
    accuracy : {"exact", "balanced", "fast"} or float
        Largest relative error of the gradient that is allowed in exchange for time: 0, 1e-2, 5e-2, or the number
        given; in the 2-norm, beside "exact". :meth:`plan` says what is done with it. At every accuracy the gradient is
        the exact derivative of the value.
    channel_axis : int or None
        Where the channels are; None for images without channels.
    nan_policy : {"raise", "mask"}
        What happens to pixels that are not finite.
    tone : LogTone, optional
        A tone curve for images of high dynamic range. `bounds`, beta and the clipping of values beyond the bounds are
        those of the values that it gives.

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

    def __init__(
        self,
        reference: Array,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
    ) -> None:
        super().__init__(reference, channel_axis=channel_axis, nan_policy=nan_policy, tone=tone)
        if scales is None:
            scales = ScaleSpace.for_image(self._reference_layout.height, self._reference_layout.width)
        if not isinstance(scales, ScaleSpace):
            msg = f"`scales` must be a ScaleSpace, got {type(scales).__name__}"
            raise ScaleError(msg)
        self._scales = scales
        self._tolerance = gradient_tolerance(accuracy)

    @property
    def scales(self) -> ScaleSpace:
        """The scales that are compared."""
        return self._scales

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
        )
        return replace(plan, compiled=available())

    def _prepare(self, reference: Array) -> _Prepared:
        scales = self._scales
        plan = self.plan(*reference.shape[-2:], eps=epsilon(reference))
        prepared = _Prepared(scales, plan, clip(reference, *scales.bounds))
        # Now, and not when it is first used: that may be where JAX traces.
        _ = prepared.kernels if _by_kernels(reference) else prepared.arrays
        return prepared

    def _compares_on_host(self, image: Array) -> bool:
        return serves(image)

    def _evaluate(self, planes: Array, prepared: _Prepared, *, gradient: bool) -> Evaluation[ScaleKey]:
        bounds = self._scales.bounds
        compare = prepared.by_kernels if _by_kernels(planes) else prepared.by_arrays
        terms, cotangent = compare(clip(planes, *bounds), gradient=gradient)
        return Evaluation(terms, clip_pullback(planes, cotangent, *bounds) if gradient else None)


def _by_kernels(planes: Array) -> bool:
    return is_numpy_array(planes) and serves(planes)


@dataclass(frozen=True)
class _Prepared:
    """All that depends on the reference alone, for either way of comparing; each gives terms and a cotangent."""

    scales: ScaleSpace
    plan: Plan
    reference: Array  # within the bounds, shape (N, H, W)

    @cached_property
    def arrays(self) -> tuple[InnerComparison, ...]:
        """For arrays of the reference's library."""
        return tuple(
            InnerComparison.of(self.scales, inner, self.plan.tonal, self.reference) for inner in self.plan.inner
        )

    @cached_property
    def kernels(self) -> tuple[CompiledComparison, ...]:
        """For NumPy's."""
        from loi_core.compiled.comparison import CompiledComparison

        return tuple(
            CompiledComparison.of(self.scales, inner, self.plan.tonal, self.reference) for inner in self.plan.inner
        )

    def by_arrays(self, clipped: Array, *, gradient: bool) -> tuple[Terms, Array | None]:
        """As operations on whole arrays, of any library."""
        xp = namespace(clipped)
        terms = {key: xp.zeros((), dtype=clipped.dtype, device=device(clipped)) for key in self.scales.keys}
        cotangents = [inner.add(clipped, terms, gradient=gradient) for inner in self.arrays]
        total: Array = cotangents[0]
        if gradient:
            for cotangent in cotangents[1:]:
                total += cotangent
        return terms, total

    def by_kernels(self, clipped: Array, *, gradient: bool) -> tuple[Terms, Array | None]:
        """As compiled loops, for what :func:`loi_core.compiled.serves`."""
        from loi_core.compiled.comparison import compare

        costs, cotangent = compare(self.kernels, clipped, gradient=gradient)
        return {key: np.asarray(cost, clipped.dtype) for key, cost in costs.items()}, cotangent

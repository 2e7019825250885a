"""The loss of images that are large, or not in memory at all: read, compared and written tile by tile."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from loi_core.errors import ImageError, ImageTypeError, NonFiniteImageError, OptionError, ScaleError
from loi_core.method.comparison import ScaleKey
from loi_core.method.sampling_error import error_of, is_within
from loi_core.method.scales import ScaleSpace
from loi_core.method.tiled.coarse import tiles_of
from loi_core.method.tiled.comparison import Tiled, TiledComparison
from loi_core.objectives.facts import facts_of_options, facts_of_reference, facts_of_scales, in_notebook, printed
from loi_core.objectives.loi import accuracy_name, gradient_tolerance
from loi_core.objectives.windows import Pixels, Plane, Shares
from loi_core.pixels.bounds import warn_if_clipped
from loi_core.pixels.layout import check_channel_axis
from loi_core.pixels.nonfinite import NanPolicy, check_nan_policy, require_finite
from loi_core.pixels.tone_curve import LogTone, check_tone
from loi_core.support.arrays import Array, Host, detached, from_numpy, is_array_api_obj, is_numpy_array
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["TiledLOIObjective"]

SIDE: Final = 1024
GLANCED: Final = 2**20  # values of a reference that are looked at for its range


class TiledLOIObjective:
    """What :class:`LOIObjective` computes, tile by tile: for large images, and for those that are not in memory.

    Value and gradient are the same up to rounding. The reference is not copied: beside what is given and the gradient,
    a few tiles are in memory, and for each tonal level one coarse sampling of one channel. Arrays may be memory maps,
    as ``numpy.load(path, mmap_mode="r")`` gives them.

    Parameters
    ----------
    reference : array, shape (H, W, C)
        What the image should look like; floating point, or unsigned integers, which count as fractions of their
        largest. It must not change.
    scales : ScaleSpace, optional
        The scales to compare; ``ScaleSpace.for_image(H, W)`` by default.
    accuracy : {"exact", "balanced", "fast"} or float
        As for :class:`LOIObjective`. It is made use of by wide extents under the boundary "reflect" alone; all else is
        exact.
    tile : int
        Side of a tile, in pixels, 1 or more. Time hardly depends on it from 512 on; memory grows with its square.
    channel_axis : int or None
        Where the channels are; None for images without channels, (H, W).
    nan_policy, tone
        As for :class:`LOIObjective`.
    weights : array, shape (H, W), optional
        How much each pixel counts, 0 or more. Not copied either.

    Raises
    ------
    OptionError, ImageError, ImageTypeError, ScaleError
        If an argument is not allowed.
    NonFiniteImageError
        Under ``nan_policy="raise"``, if the reference holds NaN or infinite values.

    Examples
    --------
    >>> import numpy as np
    >>> reference = np.zeros((32, 32, 1)); reference[20:24, 20:24] = 1.0
    >>> image = np.zeros((32, 32, 1)); image[4:8, 4:8] = 1.0
    >>> objective = TiledLOIObjective(reference, ScaleSpace(sigma=1, alpha=(1, 5), beta=0.125), tile=16)
    >>> value, gradient = objective.value_and_grad(image)
    >>> gradient.shape
    (32, 32, 1)
    """

    def __init__(
        self,
        reference: Array,
        scales: ScaleSpace | None = None,
        accuracy: str | float = "exact",
        *,
        tile: int = SIDE,
        channel_axis: int | None = -1,
        nan_policy: NanPolicy = "raise",
        tone: LogTone | None = None,
        weights: Array | None = None,
    ) -> None:
        side = whole_number(tile)
        if side is None or side < 1:
            msg = f"`tile` must be a whole number of pixels, 1 or more, got {shown(tile)}"
            raise OptionError(msg)
        self._channel_axis = check_channel_axis(channel_axis)
        self._nan_policy = check_nan_policy(nan_policy)
        self._tone = check_tone(tone)
        self._tolerance = gradient_tolerance(accuracy)
        self._reference = Pixels.of("reference", reference, self._channel_axis)
        height, width = self._reference.size
        self._side, self._tiles = side, tiles_of(height, width, side)
        if scales is None:
            scales = ScaleSpace.for_image(height, width)
        if not isinstance(scales, ScaleSpace):
            msg = f"`scales` must be a ScaleSpace, got {type(scales).__name__}"
            raise ScaleError(msg)
        self._scales = scales
        self._weights = None if weights is None else Shares.of(weights, (height, width), self._tiles)
        if self._nan_policy == "raise":
            self._require_finite(self._reference)
        step = max(1, math.isqrt(height * width * self._reference.planes // GLANCED))
        glance = self._reference.every(step)
        glance = np.where(np.isfinite(glance), glance, scales.bounds[0])
        warn_if_clipped(glance if tone is None else tone.apply(glance), None, scales.bounds)

    def __repr__(self) -> str:
        return printed(type(self).__name__, self._facts())

    def _repr_html_(self) -> str:
        return in_notebook(type(self).__name__, self._facts(), self._reference.given, self._channel_axis)

    def _facts(self) -> dict[str, str]:
        given, weights = self._reference.given, None if self._weights is None else self._weights.given.shape
        return (
            facts_of_reference(given.shape, given.dtype)
            | facts_of_scales(self._scales)
            | {"accuracy": accuracy_name(self._tolerance), "tile": str(self._side)}
            | facts_of_options(self._channel_axis, self._nan_policy, self._tone, weights)
        )

    @property
    def reference(self) -> Array:
        """The reference as it was given."""
        return self._reference.given

    @property
    def scales(self) -> ScaleSpace:
        """The scales that are compared."""
        return self._scales

    @property
    def tile(self) -> int:
        """Side of a tile, in pixels."""
        return self._side

    def value(self, image: Array) -> Array:
        """The objective at `image`, a 0-d array of its library.

        Parameters
        ----------
        image : array, shape (H, W, C)
            Floating point, or unsigned integers, which count as fractions of their largest. Of any library; what is on
            another device is copied.

        Raises
        ------
        ImageTypeError, ImageError
            If the type or shape does not fit the reference.
        NonFiniteImageError
            Under ``nan_policy="raise"``, if a pixel is NaN or infinite.
        """
        pixels = self._read(image)
        return _scalar(sum(self._compare(pixels, None).values()), image, pixels.dtype)

    def value_and_grad(self, image: Array, out: Host | None = None) -> tuple[Array, Array]:
        """The objective at `image` and its gradient.

        Parameters
        ----------
        image : array, shape (H, W, C)
            See :meth:`value`.
        out : array, shape (H, W, C), optional
            Where the gradient is to go, such as ``numpy.lib.format.open_memmap(path, "w+", "float32", shape)``: of the
            image's dtype, float32 for integers and for floats of 16 bits. What it holds is overwritten.

        Returns
        -------
        value : array, shape ()
        gradient : array, shape (H, W, C)
            `out`, or a new array of the image's library.
        """
        pixels = self._read(image)
        gradient = np.empty(pixels.given.shape, pixels.dtype) if out is None else _checked(out, pixels)
        value = _scalar(sum(self._compare(pixels, gradient).values()), image, pixels.dtype)
        return value, gradient if out is not None or is_numpy_array(image) else from_numpy(gradient, image)

    def terms(self, image: Array) -> dict[ScaleKey, Array]:
        """What each scale adds to the value: ``{(alpha, beta, sigma): 0-d array}``. Errors as in :meth:`value`."""
        pixels = self._read(image)
        return {key: _scalar(term, image, pixels.dtype) for key, term in self._compare(pixels, None).items()}

    def _read(self, image: Array) -> Pixels:
        pixels = Pixels.of("image", detached(image) if is_array_api_obj(image) else image, self._channel_axis)
        if pixels.given.shape != self._reference.given.shape:
            msg = (
                f"`image` has shape {pixels.given.shape}, which does not fit the reference's shape "
                f"{self._reference.given.shape}"
            )
            raise ImageError(msg)
        if self._nan_policy == "raise":
            self._require_finite(pixels)
        return pixels

    def _compare(self, image: Pixels, gradient: Host | None) -> dict[ScaleKey, float]:
        comparison = TiledComparison(
            self._scales, *image.size, image.planes, self._side, image.dtype, self._weights is not None
        )
        terms = dict.fromkeys(self._scales.keys, 0.0)
        for channel in range(image.planes):
            cotangent = None if gradient is None else image.view(gradient, channel)
            plane = Plane(
                *(image, self._reference, channel, self._scales, self._nan_policy == "mask", self._tone),
                *(self._weights, cotangent),
            )

            def compare(tolerance: float, plane: Plane = plane) -> tuple[Tiled, float]:
                plane.clear(self._tiles)
                found = comparison.compare(plane, tolerance=tolerance, gradient=plane.cotangent is not None)
                return found, plane.carry_back(self._tiles)

            found, norm = compare(self._tolerance)
            error = error_of(found.misplaced)
            if error > 0.0 and not is_within(error * plane.factor, self._tolerance, norm):
                compare(0.0)  # the gradient is exact then; the value remains that of the plan
            for key, term in found.terms.items():
                terms[key] += term * (1.0 if self._weights is None else self._weights.largest)
        return terms

    def _require_finite(self, pixels: Pixels) -> None:
        """Raise for values that are not finite, of pixels that count."""
        if pixels.given.dtype.kind != "f":
            return
        found: NonFiniteImageError | None = None
        kinds = 0, 0, 0
        first: tuple[int, ...] = ()
        for tile in self._tiles:
            values = pixels.values(tile)
            if self._weights is not None:
                counts = pixels.spread(self._weights.within(tile, pixels.dtype) > 0.0)
                values = np.where(counts, values, 0.0)
            try:
                require_finite(pixels.name, values, self._channel_axis)
            except NonFiniteImageError as error:
                if found is None:
                    found, first = error, pixels.moved(error, tile)
                kinds = kinds[0] + error.nan, kinds[1] + error.positive, kinds[2] + error.negative
        if found is not None:
            raise NonFiniteImageError(found.name, kinds, first, found.axes, pixels.given.size, found.suspicion)


def _scalar(value: float, image: Array, dtype: np.dtype[Any]) -> Array:
    """A number as an array of the image's library, of a dtype that it is compared in."""
    number = np.asarray(value, dtype)
    if is_numpy_array(image):
        return number
    return from_numpy(number, image)


def _checked(out: Host, pixels: Pixels) -> Host:
    if not is_numpy_array(out):
        msg = f"`out` must be a NumPy array, got {type(out).__name__}"
        raise ImageTypeError(msg)
    if out.shape != pixels.given.shape or out.dtype != pixels.dtype or not out.flags.writeable:
        kind = "" if out.flags.writeable else ", read-only"
        wanted = f"shape {pixels.given.shape} and dtype {pixels.dtype}"
        msg = f"`out` must be of {wanted}, got {out.shape} and {out.dtype}{kind}"
        raise ImageError(msg)
    return out

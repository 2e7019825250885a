"""The catalogue of hard cases: inputs that renders and users give to a loss when it is needed most."""

from __future__ import annotations

import functools
from functools import partial
from typing import Final

import numpy as np

from loi_core.errors import NonFiniteImageError
from loi_core.method.scales import ScaleSpace
from loi_core.stability.array_cases import array_cases, batch_cases, tie_cases
from loi_core.stability.case import SHAPE, HardCase, Pair, as_float32, disk, flat, noise, pair, pair_with_outliers, ramp

__all__ = ["hard_cases"]

TINY_SHAPE: Final = (5, 4, 1)  # for cases of many levels
WIDE: Final = "a kernel ten times as wide as the image folds into it thousands of times"
MEAN: Final = "reflection makes the blur the mean over the image, summed as a short cosine series"
REFUSED: Final = "an error that counts the bad pixels and names the first"
MASKED: Final = "bad pixels count as equal to the reference, and their gradient is 0"
SPREADS: Final = "one pixel spreads through every blur to the whole gradient"


@functools.cache
def hard_cases() -> tuple[HardCase, ...]:
    """Return all cases, in the order of reports."""
    return (
        *_equal_image_cases(),
        *_range_cases(),
        *_bad_pixel_cases(),
        *_scale_cases(),
        *_size_cases(),
        *tie_cases(),
        *batch_cases(),
        *array_cases(),
    )


def _equal_image_cases() -> list[HardCase]:
    """Images that are equal, nearly equal, or of one intensity."""

    def one_pixel() -> Pair:
        image = disk(0.5, 0.5)
        image[4, 15, 1] = 0.75
        return image, disk(0.5, 0.5)

    def equal() -> Pair:
        return disk(0.5, 0.5), disk(0.5, 0.5)

    nearly = "such a difference counts as a tie: in float32 no distance and no gradient"
    return [
        HardCase("ordinary pair", "none; for comparison", "the gradient moves the object to its goal", pair, half=True),
        HardCase("identical images", "rounding noise and random signs", "all differences are 0", equal, half=True),
        HardCase(
            "one pixel differs", "noise outweighs it", "only pixels near it have a gradient", one_pixel, half=True
        ),
        HardCase(
            "reference plus 1e-7",
            "one rounding becomes a gradient of full size",
            nearly,
            lambda: (disk(0.5, 0.5), as_float32(disk(0.5, 0.5) + 1e-7)),
        ),
        HardCase(
            "flat against flat",
            "there are no edges",
            "every pixel has the same gradient, towards the other intensity",
            lambda: (flat(0.3), flat(0.7)),
            half=True,
        ),
        HardCase(
            "all black against a render",
            "clipping has no derivative at a bound",
            "a pixel on a bound counts as inside",
            lambda: (flat(0.0), disk(0.5, 0.5)),
            half=True,
        ),
        HardCase(
            "all white against all black",
            "saturation at both ends",
            "levels beyond the bounds keep mass and gradient",
            lambda: (flat(1.0), flat(0.0)),
            half=True,
        ),
    ]


def _range_cases() -> list[HardCase]:
    """Values at and beyond the bounds, and of unusual size."""

    def near_bounds(sign: float) -> Pair:
        image, reference = pair()
        image[:8], image[8:] = sign * -1e-7, 1.0 + sign * 1e-7
        return as_float32(image), reference

    def scaled(offset: float, factor: float) -> Pair:
        image, reference = pair()
        return as_float32(offset + factor * image), as_float32(offset + factor * reference)

    def denormal() -> Pair:
        image, reference = pair()
        image[:8] = 1e-40
        image[8:, :4] = 1e-310
        return image, reference

    offset_scales = ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, bounds=(1000.0, 1001.0))
    radiance_scales = ScaleSpace((0.0, 1.0), (1.0, 4.0), 1250.0, bounds=(0.0, 1e4))
    return [
        HardCase(
            "just inside the bounds",
            "one rounding takes it beyond",
            "the whole gradient is kept",
            partial(near_bounds, -1.0),
        ),
        HardCase(
            "just beyond the bounds",
            "a clipped value has no derivative",
            "values beyond a bound are compressed, with the slope 1 at the bound",
            partial(near_bounds, 1.0),
        ),
        HardCase(
            "far beyond the bounds",
            "no level is near the values",
            "they count by their logarithm",
            lambda: (ramp(SHAPE, -3.0, 4.0), disk(0.5, 0.5)),
            half=True,
        ),
        HardCase(
            "bounds far from zero",
            "float32 rounds levels near 1000 to 6e-5",
            "the error bound grows with it, and holds",
            partial(scaled, 1000.0, 1.0),
            offset_scales,
        ),
        HardCase(
            "radiance up to 1e4",
            "sizes differ widely in one sum",
            "bounds and beta scale with radiance",
            partial(scaled, 0.0, 1e4),
            radiance_scales,
        ),
        HardCase(
            "fireflies of 1e4",
            "an outlier outweighs all other pixels",
            "intensities are compressed before any blur",
            partial(pair_with_outliers, 1e4, count=5),
            half=True,
        ),
        HardCase(
            "fireflies of 1e30",
            "squares overflow in float32",
            "every distance beyond 2 million betas counts alike",
            partial(pair_with_outliers, 1e30, count=5),
        ),
        HardCase(
            "negative radiance",
            "logarithms and powers are NaN",
            "it counts as black and is pulled back to the bounds",
            partial(pair_with_outliers, -5.0, count=5),
            half=True,
        ),
        HardCase("denormal radiance", "1 / x is infinite", "intensities are subtracted, never divided by", denormal),
    ]


def _bad_pixel_cases() -> list[HardCase]:
    """Pixels that are not finite."""

    def reference_too() -> Pair:
        image, reference = pair_with_outliers(np.nan)
        reference[10, 3] = np.inf
        return image, reference

    def all_nan() -> Pair:
        return flat(np.nan), pair()[1]

    nan, inf, minus = (partial(pair_with_outliers, value) for value in (np.nan, np.inf, -np.inf))
    error, zero = NonFiniteImageError, "the mean is over all pixels: loss and gradient are 0"
    return [
        HardCase("one NaN", SPREADS, REFUSED, nan, error=error),
        HardCase("one infinite pixel", "clipping hides it, and the render stays broken", REFUSED, inf, error=error),
        HardCase("all NaN", "an optimiser carries a loss of NaN into its state", REFUSED, all_nan, error=error),
        HardCase("one NaN, masked", SPREADS, MASKED, nan, nan_policy="mask", half=True),
        HardCase("one infinite pixel, masked", SPREADS, MASKED, minus, nan_policy="mask"),
        HardCase("bad pixels in both images, masked", SPREADS, MASKED, reference_too, nan_policy="mask"),
        HardCase("all NaN, masked", "0 / 0 in the mean over the remaining pixels", zero, all_nan, nan_policy="mask"),
    ]


def _scale_cases() -> list[HardCase]:
    """Scales at the ends of their ranges."""

    def tiny() -> Pair:
        return noise(TINY_SHAPE, 1), noise(TINY_SHAPE, 2)

    def uneven() -> Pair:
        return disk(0.35, 0.3), ramp()

    betas = (
        (1e-4, "10,000 levels; float32 resolves 6e-4 beta only", "the error bound grows as eps / beta, and holds"),
        (1e-3, "1,000 levels; exp underflows at most of them", "an underflow is 0 and adds nothing"),
        (1e-2, "levels much finer than the noise of a render", "no special treatment"),
        (1.0, "one soft histogram covers all intensities", "loss and gradient are nearly linear in intensity"),
        (10.0, "differences of CDFs are small beside the CDFs", "they barely exceed the tie threshold, 16 roundings"),
    )
    small, large = ScaleSpace(1e-3, 1e-3, 0.125), ScaleSpace(200.0, 200.0, 0.125)
    outside = ScaleSpace((0.0, 3.0), (1.0, 30.0), 0.125, boundary="zero")
    two = ScaleSpace((0.0, 1.0), (1.0, 4.0), 1.0, tails=0.0)
    many = ScaleSpace((0.0, 1.0), (0.0, 2.0), 1.0 / 1015.0)
    single = ScaleSpace.released((0.0, 1.0), (1.0, 4.0), 1, 9)
    released = ScaleSpace.released((0.0, 2.0), (1.0, 4.0), 8, 9)
    lost = "both images lose the same mass; `boundary` explains why this is not the default"
    return [
        *(
            HardCase(
                f"beta {beta:g}", danger, answer, tiny if beta < 0.1 else pair, ScaleSpace((0.0, 1.0), (0.0, 2.0), beta)
            )
            for beta, danger, answer in betas
        ),
        HardCase("no blur at all", "a Gaussian of width 0 is 0 / 0", "no blur", pair, ScaleSpace(0.0, 0.0, 0.125)),
        HardCase("blur of a thousandth of a pixel", "sigma**2 underflows", "distances are divided first", pair, small),
        HardCase("sigma ten times the image", WIDE, MEAN, uneven, ScaleSpace(200.0, (0.0, 2.0), 0.125)),
        HardCase("alpha ten times the image", WIDE, MEAN, uneven, ScaleSpace((0.0, 1.0), 200.0, 0.125)),
        HardCase("sigma and alpha ten times the image", WIDE, MEAN, uneven, large),
        HardCase("black outside the image", "a wide blur loses nearly all mass at the border", lost, pair, outside),
        HardCase("1 level", "intensities have no second level", "only the density is compared", pair, single),
        HardCase("2 levels", "without tails a saturated pixel loses half its mass", "`tails` adds levels", pair, two),
        HardCase(
            "1024 levels", "a thousand additions in sequence", "only levels near a pixel add anything", tiny, many
        ),
        HardCase(
            "released convention", "densities reach 1 / beta", "tie rule and bounds scale with them", pair, released
        ),
    ]


def _size_cases() -> list[HardCase]:
    """Images of unusual sizes, and long sums."""

    def noises(shape: tuple[int, ...]) -> Pair:
        return noise(shape, 3), noise(shape, 4)

    def many_terms() -> Pair:
        shape = (32, 32, 16)
        image = flat(0.3, shape)
        image[8:16, 8:16] = 0.625
        return as_float32(image), flat(0.7, shape)

    sizes = (
        ((1, 1, 3), "no neighbours: every blur must be the identity"),
        ((1, 64, 3), "an axis of one pixel, reflected at both sides"),
        ((64, 1, 3), "the other axis of one pixel"),
        ((2, 2, 3), "all kernels are wider than the image"),
        ((16, 20, 1), "an axis of length 1 that must not be dropped"),
        ((16, 20, 2), "two channels are neither grey nor colour"),
        ((16, 20, 16), "as many channels as a spectral render has"),
    )
    planes, means = "channels are planes, and each axis has its own kernel", "sums are made in pairs, or of means"
    return [
        *(
            HardCase(f"{height}x{width}, {count} channel{'s' * (count > 1)}", danger, planes, partial(noises, shape))
            for shape, danger in sizes
            for height, width, count in [shape]
        ),
        HardCase(
            "3x4096",
            "1,000 taps along one axis, 300 reflections along the other",
            "each axis is blurred by its own matrix",
            partial(noises, (3, 4096, 1)),
            ScaleSpace(0.0, 100.0, 0.25),
        ),
        HardCase(
            "a sum of 1e7 terms",
            "float32 sums stop at 2**24 terms",
            means,
            many_terms,
            ScaleSpace(0.0, 1.0, 1.0 / 602.0),
        ),
    ]

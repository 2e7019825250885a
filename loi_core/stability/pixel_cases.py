"""Hard cases of what pixels hold: equal images, values beyond the bounds, and what is not a number."""

from __future__ import annotations

import numpy as np

from loi_core.errors import NonFiniteImageError
from loi_core.method.scales import ScaleSpace
from loi_core.stability.case import HardCase, Pair, pair, spoilt
from loi_core.stability.pictures import SHAPE, flat, ramp, render, single

__all__ = ["bad_pixel_cases", "equal_image_cases", "range_cases"]


def equal_image_cases() -> list[HardCase]:
    """Images that are equal, nearly equal, or hold one intensity."""

    def one_pixel() -> Pair:
        image = render(0.5, 0.5)
        image[4, 15, 1] = 0.75
        return image, render(0.5, 0.5)

    return [
        HardCase(
            "ordinary pair",
            "nothing; it shows what an easy case looks like in the table",
            "the object is pulled to where it should be",
            pair,
            half=True,
        ),
        HardCase(
            "identical images",
            "rounding noise instead of 0, and with it a gradient of random signs",
            "both pass through the same operations, so all differences are 0 to the bit",
            lambda: (render(0.5, 0.5), render(0.5, 0.5)),
            half=True,
        ),
        HardCase(
            "one pixel differs",
            "the difference drowns in the sum over all pixels, or noise elsewhere outweighs it",
            "only what the kernels see of that pixel has a gradient",
            one_pixel,
            half=True,
        ),
        HardCase(
            "reference plus 1e-7",
            "a difference of one rounding is blown up to a gradient of full size",
            "where rounding alone could have made a difference it is a tie: in float32 no distance and no gradient",
            lambda: (render(0.5, 0.5), single(render(0.5, 0.5) + 1e-7)),
        ),
        HardCase(
            "flat against flat",
            "no edges to hold on to; all pixels ask for the same",
            "every pixel gets the same gradient, towards the other intensity",
            lambda: (flat(0.3), flat(0.7)),
            half=True,
        ),
        HardCase(
            "all black against a render",
            "every pixel lies on a bound, where clipping has no derivative",
            "a pixel on a bound is inside and keeps its gradient",
            lambda: (flat(0.0), render(0.5, 0.5)),
            half=True,
        ),
        HardCase(
            "all white against all black",
            "the greatest distance that there is; saturation at both ends",
            "levels reach beyond the bounds, so both ends keep their mass and their gradient",
            lambda: (flat(1.0), flat(0.0)),
            half=True,
        ),
    ]


def range_cases() -> list[HardCase]:
    """Values at and beyond the bounds, and of unusual size."""

    def near_bounds(sign: float) -> Pair:
        image, reference = pair()
        image[:8], image[8:] = sign * -1e-7, 1.0 + sign * 1e-7
        return single(image), reference

    def denormal() -> Pair:
        image, reference = pair()
        image[:8] = 1e-40
        image[8:, :4] = 1e-310
        return image, reference

    return [
        HardCase(
            "just inside the bounds",
            "1e-7 and 1 - 1e-7 are one rounding from being clipped",
            "they are inside and keep all of their gradient",
            lambda: near_bounds(-1.0),
        ),
        HardCase(
            "just beyond the bounds",
            "the gradient of a clipped value is 0: the pixel would be lost for good",
            "a clipped value keeps the gradient that points back inside",
            lambda: near_bounds(1.0),
        ),
        HardCase(
            "far beyond the bounds",
            "as before, and histograms of values that no level is near to",
            "they count as the bound itself and feel which way to go",
            lambda: (ramp(SHAPE, -3.0, 4.0), render(0.5, 0.5)),
            half=True,
        ),
        HardCase(
            "bounds far from zero",
            "levels near 1000 are rounded to 6e-5 in float32, a share of beta",
            "the bound on the error grows with it, and holds",
            lambda: (single(1000.0 + pair()[0]), single(1000.0 + pair()[1])),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, bounds=(1000.0, 1001.0)),
        ),
        HardCase(
            "radiance up to 1e4",
            "intensities and weights of widely different sizes in one sum",
            "bounds and beta are in units of radiance, so nothing but their ratio matters",
            lambda: (single(1e4 * pair()[0]), single(1e4 * pair()[1])),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 1250.0, bounds=(0.0, 1e4)),
        ),
        HardCase(
            "fireflies of 1e4",
            "one Monte Carlo outlier outweighs, or after a blur outshines, all other pixels",
            "intensities are clipped to the bounds before they are blurred",
            lambda: spoilt(1e4, count=5),
            half=True,
        ),
        HardCase(
            "fireflies of 1e30",
            "squares overflow to infinity in float32, and infinity minus itself is NaN",
            "clipped before anything is computed with them",
            lambda: spoilt(1e30, count=5),
        ),
        HardCase(
            "negative radiance",
            "filters with negative lobes and denoisers make it; logarithms and powers of it are NaN",
            "it counts as black and is pulled back to the bounds",
            lambda: spoilt(-5.0, count=5),
            half=True,
        ),
        HardCase(
            "denormal radiance",
            "slow on some processors, 0 on others, and 1 / x of it is infinite",
            "intensities are only subtracted from levels, never divided by",
            denormal,
        ),
    ]


def bad_pixel_cases() -> list[HardCase]:
    """Pixels that are not finite."""

    def reference_too() -> Pair:
        image, reference = spoilt(np.nan)
        reference[10, 3] = np.inf
        return image, reference

    refused = "an error that counts the bad pixels and names the first"
    masked = "bad pixels are taken as equal to the reference, and their gradient is 0"
    everywhere = "one pixel spreads through every blur to the whole gradient"
    return [
        HardCase("one NaN", everywhere, refused, lambda: spoilt(np.nan), error=NonFiniteImageError),
        HardCase(
            "one infinite pixel",
            "clipping hides it, and the render that made it stays broken unseen",
            refused,
            lambda: spoilt(np.inf),
            error=NonFiniteImageError,
        ),
        HardCase(
            "all NaN",
            "a loss of NaN that an optimiser carries into its state",
            refused,
            lambda: (flat(np.nan), pair()[1]),
            error=NonFiniteImageError,
        ),
        HardCase("one NaN, masked", everywhere, masked, lambda: spoilt(np.nan), nan_policy="mask", half=True),
        HardCase("one infinite pixel, masked", everywhere, masked, lambda: spoilt(-np.inf), nan_policy="mask"),
        HardCase("bad pixels in both images, masked", everywhere, masked, reference_too, nan_policy="mask"),
        HardCase(
            "all NaN, masked",
            "0 / 0, where a mean is taken over the pixels that are left",
            "the mean is over all pixels: the loss is 0, and so is the gradient",
            lambda: (flat(np.nan), pair()[1]),
            nan_policy="mask",
        ),
    ]

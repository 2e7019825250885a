"""Hard cases of scales and sizes: levels, kernels, axes and sums of any length."""

from __future__ import annotations

import functools
from typing import Final

from loi_core.method.scales import ScaleSpace
from loi_core.stability.case import HardCase, Pair, pair
from loi_core.stability.pictures import flat, noise, ramp, render, single

__all__ = ["scale_cases", "size_cases"]

TINY: Final = (5, 4, 1)  # where it is the number of levels that matters


def scale_cases() -> list[HardCase]:
    """Scales at the ends of their ranges."""

    def tiny_pair() -> Pair:
        return noise(TINY, 1), noise(TINY, 2)

    def uneven() -> Pair:
        return render(0.35, 0.3), ramp()

    found = [
        HardCase(
            f"beta {beta:g}",
            danger,
            answer,
            tiny_pair if beta < 0.1 else pair,
            ScaleSpace((0.0, 1.0), (0.0, 2.0), beta),
        )
        for beta, danger, answer in (
            (
                1e-4,
                "10,000 levels; float32 holds an intensity to 6e-4 beta only",
                "the bound grows as eps / beta, and holds",
            ),
            (
                1e-3,
                "1,000 levels, most of which see no pixel: exp underflows",
                "what underflows is 0, and adds nothing",
            ),
            (1e-2, "levels much finer than the noise of a render", "as any other"),
            (
                1.0,
                "one soft histogram covers all intensities",
                "the loss is nearly linear in intensity; so is its gradient",
            ),
            (
                10.0,
                "differences of CDFs are small beside the CDFs themselves",
                "they are above the tie rule's 16 roundings, if barely",
            ),
        )
    ]
    wide = "a kernel ten times as wide as the image is cut, or folds into it thousands of times"
    mean = "reflection makes it the mean over the image, summed as a short cosine series"
    found += [
        HardCase(
            "no blur at all",
            "a Gaussian of width 0 is 0 / 0",
            "width 0 is the identity",
            pair,
            ScaleSpace(0.0, 0.0, 0.125),
        ),
        HardCase(
            "blur of a thousandth of a pixel",
            "exp(-x**2 / sigma**2) underflows, or the square of sigma does",
            "the distance is divided by sigma before it is squared",
            pair,
            ScaleSpace(1e-3, 1e-3, 0.125),
        ),
        HardCase("sigma ten times the image", wide, mean, uneven, ScaleSpace(200.0, (0.0, 2.0), 0.125)),
        HardCase("alpha ten times the image", wide, mean, uneven, ScaleSpace((0.0, 1.0), 200.0, 0.125)),
        HardCase("sigma and alpha ten times the image", wide, mean, uneven, ScaleSpace(200.0, 200.0, 0.125)),
        HardCase(
            "black outside the image",
            "with a wide blur nearly all mass is lost at the border",
            "what is lost is lost in both images alike; see `boundary` for why this is not the default",
            pair,
            ScaleSpace((0.0, 3.0), (1.0, 30.0), 0.125, boundary="zero"),
        ),
        HardCase(
            "1 level",
            "no level beside it to tell intensities apart",
            "its density is all that is compared",
            pair,
            ScaleSpace.released((0.0, 1.0), (1.0, 4.0), 1, 9),
        ),
        HardCase(
            "2 levels",
            "without tails a saturated pixel has half of its mass",
            "allowed: `tails` says how many more to have",
            pair,
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 1.0, tails=0.0),
        ),
        HardCase(
            "1024 levels",
            "errors of a thousand additions, one after another",
            "only those within reach of a pixel add anything",
            tiny_pair,
            ScaleSpace((0.0, 1.0), (0.0, 2.0), 1.0 / 1015.0),
        ),
        HardCase(
            "released convention",
            "densities that are not normalised reach 1 / beta",
            "the tie rule and all bounds scale with them",
            pair,
            ScaleSpace.released((0.0, 2.0), (1.0, 4.0), 8, 9),
        ),
    ]
    return found


def size_cases() -> list[HardCase]:
    """Images of odd sizes, and long sums."""

    def many_terms() -> Pair:
        shape = (32, 32, 16)
        image = flat(0.3, shape)
        image[8:16, 8:16] = 0.625
        return single(image), flat(0.7, shape)

    sizes = [
        ((1, 1, 3), "no neighbours: every blur must be the identity"),
        ((1, 64, 3), "an axis of one pixel, mirrored at both of its sides"),
        ((64, 1, 3), "as before, along the other axis"),
        ((2, 2, 3), "kernels are wider than the image from the start"),
        ((16, 20, 1), "an axis of length 1 that must not be dropped"),
        ((16, 20, 2), "two channels are neither grey nor colour"),
        ((16, 20, 16), "as many channels as a spectral render has"),
    ]
    found = [
        HardCase(
            f"{shape[0]}x{shape[1]}, {shape[2]} channel{'s' if shape[2] > 1 else ''}",
            danger,
            "channels are planes, and each axis has a kernel of its own",
            functools.partial(_noises, shape),
        )
        for shape, danger in sizes
    ]
    return [
        *found,
        HardCase(
            "3x4096",
            "kernels of 1,000 taps along one axis, folded three hundred times along the other",
            "each axis is blurred by a matrix of its own, in blocks",
            functools.partial(_noises, (3, 4096, 1)),
            ScaleSpace(0.0, 100.0, 0.25),
        ),
        HardCase(
            "a sum of 1e7 terms",
            "16 million equal numbers, added one by one in float32, stop at 2**24 of the first",
            "sums are made in pairs, or of means; the error does not grow with their number",
            many_terms,
            ScaleSpace(0.0, 1.0, 1.0 / 602.0),
        ),
    ]


def _noises(shape: tuple[int, ...]) -> Pair:
    return noise(shape, 3), noise(shape, 4)

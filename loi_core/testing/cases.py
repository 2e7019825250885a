"""The catalogue of hard cases: what renders and users hand to a loss when it is needed most, each with a name."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from loi_core.errors import ImageTypeError, NonFiniteImageError
from loi_core.nonfinite import NanPolicy
from loi_core.scales import ScaleSpace
from loi_core.testing import layouts
from loi_core.testing.checks import Host
from loi_core.testing.pictures import SHAPE, board, flat, noise, ramp, render, single

__all__ = ["HardCase", "Pair", "hard_cases"]

Pair: TypeAlias = tuple[Host, Host]
"""An image and its reference."""

SCALES: Final = ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125)
TINY: Final = (5, 4, 1)  # where it is the number of levels that matters


@dataclass(frozen=True)
class HardCase:
    """One case that should not break anything.

    Attributes
    ----------
    name : str
        What it is called, in reports and on the command line.
    danger : str
        One line: what could go wrong.
    answer : str
        One line: what the library does.
    make : callable
        Makes the image and the reference, both float64, shape (*batch, H, W, C).
    scales : ScaleSpace
    nan_policy : {"raise", "mask"}
    error : type of exception, optional
        What must be raised; None if there must be an answer.
    layout : callable, optional
        How the image lies in memory, or what it holds in place of floats: from an array to another. Such an image is
        handed to the core as it is.
    half : bool
        Whether images of 16 bits are tried as well.
    """

    name: str
    danger: str
    answer: str
    make: Callable[[], Pair]
    scales: ScaleSpace = SCALES
    nan_policy: NanPolicy = "raise"
    error: type[Exception] | None = None
    layout: Callable[[Host], Host] | None = None
    half: bool = False

    def __str__(self) -> str:
        return self.name


@functools.cache
def hard_cases() -> tuple[HardCase, ...]:
    """All of them, in the order in which they are reported."""
    return (*_equal(), *_ranges(), *_bad_pixels(), *_scales(), *_sizes(), *_ties(), *_batches(), *_arrays())


def _pair() -> Pair:
    return render(0.35, 0.3), render(0.6, 0.7)


def _spoilt(value: float, *, count: int = 1) -> Pair:
    """The usual pair, with some pixels of the image replaced."""
    image, reference = _pair()
    for index in range(count):
        image[3 + 2 * index, (7 + 5 * index) % SHAPE[1], index % SHAPE[2]] = value
    return single(image), reference


def _equal() -> list[HardCase]:
    def one_pixel() -> Pair:
        image = render(0.5, 0.5)
        image[4, 15, 1] = 0.75
        return image, render(0.5, 0.5)

    return [
        HardCase(
            "ordinary pair",
            "nothing; it shows what an easy case looks like in the table",
            "the object is pulled to where it should be",
            _pair,
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


def _ranges() -> list[HardCase]:
    def near_bounds(sign: float) -> Pair:
        image, reference = _pair()
        image[:8], image[8:] = sign * -1e-7, 1.0 + sign * 1e-7
        return single(image), reference

    def denormal() -> Pair:
        image, reference = _pair()
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
            lambda: (single(1000.0 + _pair()[0]), single(1000.0 + _pair()[1])),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, bounds=(1000.0, 1001.0)),
        ),
        HardCase(
            "radiance up to 1e4",
            "intensities and weights of widely different sizes in one sum",
            "bounds and beta are in units of radiance, so nothing but their ratio matters",
            lambda: (single(1e4 * _pair()[0]), single(1e4 * _pair()[1])),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 1250.0, bounds=(0.0, 1e4)),
        ),
        HardCase(
            "fireflies of 1e4",
            "one Monte Carlo outlier outweighs, or after a blur outshines, all other pixels",
            "intensities are clipped to the bounds before they are blurred",
            lambda: _spoilt(1e4, count=5),
            half=True,
        ),
        HardCase(
            "fireflies of 1e30",
            "squares overflow to infinity in float32, and infinity minus itself is NaN",
            "clipped before anything is computed with them",
            lambda: _spoilt(1e30, count=5),
        ),
        HardCase(
            "negative radiance",
            "filters with negative lobes and denoisers make it; logarithms and powers of it are NaN",
            "it counts as black and is pulled back to the bounds",
            lambda: _spoilt(-5.0, count=5),
            half=True,
        ),
        HardCase(
            "denormal radiance",
            "slow on some processors, 0 on others, and 1 / x of it is infinite",
            "intensities are only subtracted from levels, never divided by",
            denormal,
        ),
    ]


def _bad_pixels() -> list[HardCase]:
    def reference_too() -> Pair:
        image, reference = _spoilt(np.nan)
        reference[10, 3] = np.inf
        return image, reference

    refused = "an error that counts the bad pixels and names the first"
    masked = "bad pixels are taken as equal to the reference, and their gradient is 0"
    everywhere = "one pixel spreads through every blur to the whole gradient"
    return [
        HardCase("one NaN", everywhere, refused, lambda: _spoilt(np.nan), error=NonFiniteImageError),
        HardCase(
            "one infinite pixel",
            "clipping hides it, and the render that made it stays broken unseen",
            refused,
            lambda: _spoilt(np.inf),
            error=NonFiniteImageError,
        ),
        HardCase(
            "all NaN",
            "a loss of NaN that an optimiser carries into its state",
            refused,
            lambda: (flat(np.nan), _pair()[1]),
            error=NonFiniteImageError,
        ),
        HardCase("one NaN, masked", everywhere, masked, lambda: _spoilt(np.nan), nan_policy="mask", half=True),
        HardCase("one infinite pixel, masked", everywhere, masked, lambda: _spoilt(-np.inf), nan_policy="mask"),
        HardCase("bad pixels in both images, masked", everywhere, masked, reference_too, nan_policy="mask"),
        HardCase(
            "all NaN, masked",
            "0 / 0, where a mean is taken over the pixels that are left",
            "the mean is over all pixels: the loss is 0, and so is the gradient",
            lambda: (flat(np.nan), _pair()[1]),
            nan_policy="mask",
        ),
    ]


def _scales() -> list[HardCase]:
    def tiny_pair() -> Pair:
        return noise(TINY, 1), noise(TINY, 2)

    def uneven() -> Pair:
        return render(0.35, 0.3), ramp()

    found = [
        HardCase(
            f"beta {beta:g}",
            danger,
            answer,
            tiny_pair if beta < 0.1 else _pair,
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
                "they are above the tie rule's 8 roundings, if barely",
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
            _pair,
            ScaleSpace(0.0, 0.0, 0.125),
        ),
        HardCase(
            "blur of a thousandth of a pixel",
            "exp(-x**2 / sigma**2) underflows, or the square of sigma does",
            "the distance is divided by sigma before it is squared",
            _pair,
            ScaleSpace(1e-3, 1e-3, 0.125),
        ),
        HardCase("sigma ten times the image", wide, mean, uneven, ScaleSpace(200.0, (0.0, 2.0), 0.125)),
        HardCase("alpha ten times the image", wide, mean, uneven, ScaleSpace((0.0, 1.0), 200.0, 0.125)),
        HardCase("sigma and alpha ten times the image", wide, mean, uneven, ScaleSpace(200.0, 200.0, 0.125)),
        HardCase(
            "black outside the image",
            "with a wide blur nearly all mass is lost at the border",
            "what is lost is lost in both images alike; see `boundary` for why this is not the default",
            _pair,
            ScaleSpace((0.0, 3.0), (1.0, 30.0), 0.125, boundary="zero"),
        ),
        HardCase(
            "1 level",
            "no level beside it to tell intensities apart",
            "its density is all that is compared",
            _pair,
            ScaleSpace.released((0.0, 1.0), (1.0, 4.0), 1, 9),
        ),
        HardCase(
            "2 levels",
            "without tails a saturated pixel has half of its mass",
            "allowed: `tails` says how many more to have",
            _pair,
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
            _pair,
            ScaleSpace.released((0.0, 2.0), (1.0, 4.0), 8, 9),
        ),
    ]
    return found


def _sizes() -> list[HardCase]:
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


def _ties() -> list[HardCase]:
    def mirrored() -> Pair:
        image = np.where(np.arange(SHAPE[1])[None, :, None] < SHAPE[1] // 2, 0.25, 0.75) + np.zeros(SHAPE)
        return image, image[:, ::-1].copy()

    return [
        HardCase(
            "ties",
            "two halves in each other's place: where they meet, |x| has no derivative, and libraries disagree",
            "a difference that rounding alone could have made has the derivative 0",
            mirrored,
            ScaleSpace(0.0, (1.0, 200.0), 0.125),
        ),
        HardCase(
            "checkerboard against its inverse",
            "the finest pattern there is, and its opposite: blurred they are the same, and the rest is noise",
            "alpha = 0 tells them apart; where they are the same, they are ties",
            lambda: (board(), board(first=1.0, second=0.0)),
            ScaleSpace(0.0, (0.0, 4.0), 0.125),
            half=True,
        ),
        HardCase(
            "checkerboard against grey",
            "they have the same mean, so a pyramid sees no difference at all",
            "histograms of black and white are not those of grey",
            lambda: (board(), flat(0.5)),
        ),
        HardCase(
            "p = 2",
            "|d|**(1/2) is infinitely steep at 0, where most differences are",
            "the tie rule ends the slope at 8 roundings; steep it stays, and the bound says by how much",
            _pair,
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=2.0),
        ),
        HardCase(
            "p = 2, identical images",
            "0 times infinity",
            "no difference, no slope",
            lambda: (render(0.5, 0.5), render(0.5, 0.5)),
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=2.0),
        ),
        HardCase(
            "p = 1/2",
            "squares of small differences underflow",
            "they are then below rounding of the sum anyway",
            _pair,
            ScaleSpace((0.0, 1.0), (1.0, 4.0), 0.125, p=0.5),
        ),
    ]


def _batches() -> list[HardCase]:
    def batch(value: float) -> Pair:
        image, reference = _spoilt(value)
        return np.stack([render(0.3, 0.6), image]), np.stack([reference, reference])

    return [
        HardCase(
            "batch",
            "one image's gradient reaches another's",
            "images of a batch are planes that never meet",
            lambda: batch(0.5),
        ),
        HardCase(
            "batch with one bad image",
            "the good image is lost with the bad",
            "an error that says which one is bad",
            lambda: batch(np.nan),
            error=NonFiniteImageError,
        ),
        HardCase(
            "batch with one bad image, masked",
            "a NaN spreads to the other image",
            "the other image's gradient is the same to the bit",
            lambda: batch(np.nan),
            nan_policy="mask",
        ),
        HardCase(
            "batch with one black image",
            "one image is far off and the other nearly right",
            "the mean over the batch; neither changes the other's share",
            lambda: (np.stack([flat(0.0), _pair()[0]]), _pair()[1]),
        ),
    ]


def _arrays() -> list[HardCase]:
    views = [
        ("not contiguous", layouts.strided, "a library reads memory in order and sees another image"),
        ("negative strides", layouts.negative_strides, "as before; torch takes no such array"),
        ("zero strides", layouts.zero_strides, "a broadcast view: writing to one pixel writes to many"),
        ("read-only", layouts.read_only, "in-place arithmetic on the caller's memory fails, or worse, does not"),
    ]
    others = [
        (
            "big-endian",
            layouts.big_endian,
            "numbers read in the wrong order of bytes",
            "refused: the conversion is named",
        ),
        (
            "masked array",
            layouts.masked,
            "most functions forget the mask",
            "refused: fill it and pass nan_policy='mask'",
        ),
        ("8-bit integers", layouts.bytes_of_image, "255 is taken for a radiance of 255", "refused: divide by 255"),
        ("boolean image", layouts.booleans, "a gradient that only has two values", "refused: convert it first"),
        (
            "complex image",
            layouts.complex_numbers,
            "|z| and its derivative are another loss",
            "refused: convert it first",
        ),
        ("object array", layouts.objects, "slow, and any object may hide in it", "refused: convert it first"),
    ]
    return [
        *(
            HardCase(name, danger, "read as it is, never written to", _pair, layout=layout)
            for name, layout, danger in views
        ),
        *(
            HardCase(name, danger, answer, _pair, error=ImageTypeError, layout=layout)
            for name, layout, danger, answer in others
        ),
    ]

"""The scale space of a locally orderless image: sigma, beta and alpha, and the tonal levels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from loi_core.errors import ScaleError
from loi_core.pixels.bounds import IntensityRange
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["Boundary", "Convention", "Preset", "ScaleSpace"]

Boundary = Literal["reflect", "zero"]
Convention = Literal["paper", "released"]
Preset = Literal["vector", "path", "raster"]

PAPER_PRESETS: Final[dict[str, dict[str, tuple[float, ...]]]] = {
    # Table 1, section 4.2 and the caption of Table 3 of the paper.
    "vector": {"sigma": (1, 5, 15, 45), "alpha": (1, 5, 15), "beta": (0.125,)},
    "path": {"sigma": (1, 5), "alpha": (1, 5, 15, 45), "beta": (0.125,)},
    "raster": {"sigma": (0, 5), "alpha": (1, 5, 15, 45), "beta": (0.03125,)},
}

MAX_LEVELS: Final = 2**16  # as many as 16 bits distinguish; a finer beta would require terabytes
RELEASED_TAILS: Final = 4.0  # the released levels cover [-4 beta, 1 + 4 beta]

DEFAULT_BETAS_IN_BOUNDS: Final = 8.0
LOGARITHM_BETAS: Final = 0.25
"""Scale of the logarithm that compresses intensities beyond the bounds, in betas."""

FAR_SIGMA_FRACTION: Final = 0.125  # inner scale of the far stage, as a fraction of the longer side

REACH_SCALES: Final = 6.07
"""Distance at which the slope of the loss of a single small object is 1 % of its maximum, in units of the total blur.

Two Gaussians of a scale s a distance d apart differ by 2 erf(d / (sqrt(8) s)), whose slope falls as
exp(-d**2 / (8 s**2)); s**2 is the sum of the squares of alpha and sigma.
"""

WHOLE_IMAGE_SIDES: Final = 0.97
"""Extent, in sides, whose sensitivity to position is below 1 %: exp(-(pi x)**2 / 2), see docs/mathematics.md."""

BOUNDARIES: Final[dict[str, str]] = {
    "reflect": "boundary reflect: the image is mirrored at its border, which conserves mass",
    "zero": "boundary zero: the image is surrounded by black, and the loss may fall as objects leave the frame",
}


@suggest_keywords
@dataclass(frozen=True, init=False)
class ScaleSpace:
    """The scales of a comparison of two images, with bounds, boundary and normalisation.

    Parameters
    ----------
    sigma : float or sequence of float
        Inner scales: standard deviations, in pixels, of the blur of the image (eq. 1); 0 for no blur.
    alpha : float or sequence of float
        Extent scales: standard deviations, in pixels, of the neighbourhood of a histogram (eq. 4).
        0 compares pixel by pixel.
    beta : float or sequence of float
        Tonal scales: standard deviations, in units of intensity, of the uncertainty of a pixel (eq. 3). Losses
        warn if the smallest is wider than the bounds: a fine pattern of black and white then differs from a grey by
        less than a fifth of what black does (by 0.8 at an eighth of the bounds).
    bounds : (float, float)
        Smallest and largest intensity that is compared as it is; :attr:`intensity_range` compresses values beyond.
    boundary : {"reflect", "zero"}
        Extension beyond the image. "reflect" mirrors at the edge of the border pixels and conserves mass; "zero" is
        black, or the bound nearest to it; it loses mass at the border, and objects leave the frame.
    p : float
        Order of the distance between two cumulative histograms, ``|difference| ** (1 / p)`` (eq. 5).
    tails : float
        Extent of the levels beyond `bounds`, in units of beta, so that a saturated pixel keeps its mass.
    convention : {"paper", "released"}
        Normalisation of histograms; :meth:`released` selects the second.
    kernel_size : int, optional
        Taps of the extent kernels; required by the released convention, and not allowed otherwise.
    centred : bool
        Whether the mean over the image is subtracted from each level's difference of histograms before it is blurred,
        so that local histograms are compared without the difference of the global ones. A difference of exposure then
        hardly changes the gradient, and two images that differ by a constant are equal.

    Raises
    ------
    ScaleError
        If a value is not allowed; the message names the argument, its value and the allowed values.
    """

    sigma: tuple[float, ...]
    alpha: tuple[float, ...]
    beta: tuple[float, ...]
    bounds: tuple[float, float]
    boundary: Boundary
    p: float
    tails: float
    convention: Convention
    kernel_size: int | None
    centred: bool

    def __init__(
        self,
        sigma: float | Iterable[float],
        alpha: float | Iterable[float],
        beta: float | Iterable[float],
        bounds: tuple[float, float] = (0.0, 1.0),
        boundary: Boundary = "reflect",
        *,
        p: float = 1.0,
        tails: float = 4.0,
        convention: Convention = "paper",
        kernel_size: int | None = None,
        centred: bool = False,
    ) -> None:
        def set_field(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        set_field("sigma", _scales("sigma", sigma, zero=True))
        set_field("alpha", _scales("alpha", alpha, zero=True))
        set_field("beta", _scales("beta", beta, zero=False))
        set_field("bounds", _bounds(bounds))
        set_field("boundary", _choice("boundary", boundary, get_args(Boundary)))
        set_field("p", _number("p", p, zero=False))
        set_field("tails", _number("tails", tails, zero=True))
        set_field("convention", _choice("convention", convention, get_args(Convention)))
        set_field("kernel_size", _kernel_size(kernel_size, convention))
        set_field("centred", _flag("centred", centred))
        if convention == "released" and len(self.beta) != 1:
            msg = f"`beta` must be one value under the released convention, got {shown(beta)}"
            raise ScaleError(msg)
        span = self.bounds[1] - self.bounds[0]
        for scale in self.beta:
            if not span / scale + 2.0 * self.tails <= MAX_LEVELS or (convention == "released" and span < scale):
                msg = (
                    f"`beta` must divide the bounds into at least 1 and at most {MAX_LEVELS} levels, got {shown(scale)}"
                )
                raise ScaleError(msg)

    @classmethod
    def paper(cls, preset: Preset, *, boundary: Boundary = "reflect") -> ScaleSpace:
        """Return the scales that the paper used for vector graphics, path tracing or rasterization.

        Parameters
        ----------
        preset : {"vector", "path", "raster"}
            Table 1; section 4.2 and Table 2; the caption of Table 3.
        """
        scales = PAPER_PRESETS[_choice("preset", preset, tuple(PAPER_PRESETS))]
        return cls(scales["sigma"], scales["alpha"], scales["beta"], boundary=boundary)

    @classmethod
    def for_image(
        cls,
        height: int,
        width: int,
        *,
        beta: float | None = None,
        bounds: tuple[float, float] = (0.0, 1.0),
        boundary: Boundary = "reflect",
    ) -> ScaleSpace:
        """Return scales that reach across an image of this size: a fine image compared in wide neighbourhoods.

        The inner scale is 1 pixel. The widest extent is 0.35 of the longer side (45 pixels at 128), the others a
        third and a ninth of it. Wide inner scales would average appearance away, and narrow extents would trap objects
        in positions that match only partly; a long reach needs neither. The tonal scale is an eighth of the bounds.
        """
        _check_size(height, width)
        widest = 0.35 * max(height, width)
        extents = [round(widest / divisor, 2) for divisor in (9, 3, 1)]
        if beta is None:
            low, high = _bounds(bounds)
            beta = (high - low) / DEFAULT_BETAS_IN_BOUNDS
        return cls(1.0, [extent for extent in extents if extent > 1.0] or 1.0, beta, bounds, boundary)

    @classmethod
    def far_to_near(
        cls,
        height: int,
        width: int,
        *,
        beta: float | None = None,
        bounds: tuple[float, float] = (0.0, 1.0),
        boundary: Boundary = "reflect",
    ) -> tuple[ScaleSpace, ...]:
        """Return the scales of the stages of a fit on images of this size, ending with the scales of `for_image`.

        Textures trap objects where they match by chance, and narrow scales most of all. An inner scale of an eighth of
        the longer side averages textures away and keeps the shapes, which reach far. All stages but the last are
        centred: a photograph hardly ever has the exposure of its render, which outweighs the pull of distant objects.
        """
        last = cls.for_image(height, width, beta=beta, bounds=bounds, boundary=boundary)
        blur = round(FAR_SIGMA_FRACTION * max(height, width), 2)
        near = cls(last.sigma, last.alpha, last.beta, bounds, boundary, centred=True)
        if blur <= last.sigma[0]:
            return near, last
        far = cls((*last.sigma, blur), last.alpha[-2:], last.beta, bounds, boundary, centred=True)
        return far, near, last

    @classmethod
    def released(
        cls, sigma: float | Iterable[float], alpha: float | Iterable[float], bins: int, kernel_size: int
    ) -> ScaleSpace:
        """Return the conventions of the code that the paper's authors released, to reproduce their numbers.

        `bins` levels at the centres of equal bins over [-4 beta, 1 + 4 beta] with beta = 1 / `bins`; black
        outside the image, and values limited to [0, 1]; extent kernels of `kernel_size` taps and inner kernels
        of ``max(3, 4 * max(sigma))`` taps, both made odd and normalised; densities that are not multiplied by
        the spacing; and a mean over everything, scales included.
        """
        if (whole_number(bins) or 0) < 1:
            msg = f"`bins` must be a whole number of 1 or more, got {shown(bins)}"
            raise ScaleError(msg)
        return cls(
            sigma,
            alpha,
            1.0 / bins,
            boundary="zero",
            tails=RELEASED_TAILS,
            convention="released",
            kernel_size=kernel_size,
        )

    def describe(self, height: int, width: int) -> str:
        """Describe the effect of each scale on images of this size, in lines to print.

        Parameters
        ----------
        height, width : int
            Size of the images, in pixels.

        Returns
        -------
        str
            A line for the origin of the scales, one for every sigma, beta and alpha, and one for every rule.

        Raises
        ------
        ScaleError
            If the size is not of whole pixels, 1 or more.

        Examples
        --------
        >>> print(ScaleSpace.for_image(96, 128).describe(96, 128).splitlines()[0])
        ScaleSpace.for_image(96, 128): a fine image, compared in wide neighbourhoods
        """
        _check_size(height, width)
        is_default, source = self._source(height, width)
        low, high = self.bounds
        lines = [source, *(_sigma_line(sigma) for sigma in self.sigma)]
        if is_default:
            lines[-1] += "; a wider blur would average appearance away, and the extents provide the reach"
        for beta in self.beta:
            levels = self.levels(beta)
            eighth = ", an eighth of the bounds" if math.isclose(beta * DEFAULT_BETAS_IN_BOUNDS, high - low) else ""
            effect = "distinguishes intensities that differ by about as much"
            if beta > high - low:
                effect = "wider than the bounds, and compares little more than local means"
            lines.append(
                f"beta {beta:g}{eighth}: {effect}; {len(levels)} levels from {levels[0]:g} to {levels[-1]:g}, and time "
                f"grows with their number"
            )
        lines += [self._alpha_line(alpha, max(height, width)) for alpha in self.alpha]
        lines.append(f"bounds {low:g} to {high:g}: intensities beyond them count by their logarithm")
        lines.append(BOUNDARIES[self.boundary])
        if self.centred:
            lines.append("centred: histograms are compared without the difference of their means over the image")
        if self.p != 1.0:
            lines.append(
                f"p {self.p:g}: the difference of two cumulative histograms counts to the power {1 / self.p:g}"
            )
        if self.convention == "released":
            lines.append(
                f"released: normalised as the code of the paper's authors does, extents cut at {self.extent_taps} "
                f"pixels and blurs at {self.inner_taps}"
            )
        return "\n".join(lines)

    def _alpha_line(self, alpha: float, longer: int) -> str:
        if alpha == 0.0:
            return "alpha 0 px: pixel by pixel, so only objects that overlap after the blur have a gradient"
        reach = REACH_SCALES * math.hypot(alpha, max(self.sigma))
        if self.extent_taps is not None and self.inner_taps is not None:
            # Truncated neighbourhoods share no pixel beyond the sum of their radii.
            reach = min(reach, self.extent_taps + self.inner_taps - 2.0)
        if alpha >= WHOLE_IMAGE_SIDES * longer:
            effect = "the histogram is nearly equal everywhere, and hardly depends on position"
        elif reach >= longer:
            effect = "a single small object has a gradient everywhere in the image"
        else:
            effect = f"a single small object has a gradient up to about {reach:.0f} px away"
        return f"alpha {alpha:g} px, {alpha / longer:.2g} of the longer side: {effect}"

    def _source(self, height: int, width: int) -> tuple[bool, str]:
        """Return whether these are the scales of `for_image`, and their name."""
        if self == ScaleSpace.for_image(height, width, beta=self.beta[0], bounds=self.bounds, boundary=self.boundary):
            return True, f"ScaleSpace.for_image({height}, {width}): a fine image, compared in wide neighbourhoods"
        for preset, scales in PAPER_PRESETS.items():
            if self == ScaleSpace(scales["sigma"], scales["alpha"], scales["beta"], self.bounds, self.boundary):
                return False, f"ScaleSpace.paper({preset!r}): the paper's scales, for any size of image"
        return False, f"scales of your own, for {width} x {height} pixels"

    @property
    def padding(self) -> float:
        """Intensity within the bounds nearest to 0, which surrounds the image under the boundary "zero".

        Images are compared relative to it under either boundary, so that bounds far from 0 cost no accuracy.
        """
        return min(max(0.0, self.bounds[0]), self.bounds[1])

    @property
    def intensity_range(self) -> IntensityRange:
        """The map of intensities before they are compared: linear between the bounds, logarithmic beyond.

        The logarithm begins at a quarter of the smallest beta and ends at the outermost tonal level: with four tails,
        2.2 million betas beyond a bound. The released convention clips.
        """
        low, high = self.bounds
        if self.convention == "released" or self.tails == 0.0:
            return IntensityRange(low, high)
        beta = min(self.beta)
        return IntensityRange(low, high, LOGARITHM_BETAS * beta, self.tails * beta)

    @property
    def inner_taps(self) -> int | None:
        """Taps of the inner kernels; None for kernels exact to float64."""
        return None if self.kernel_size is None else _odd(max(3, int(4 * max(self.sigma))))

    @property
    def extent_taps(self) -> int | None:
        """Taps of the extent kernels; None for kernels exact to float64."""
        return None if self.kernel_size is None else _odd(self.kernel_size)

    @property
    def keys(self) -> list[tuple[float, float, float]]:
        """Every compared ``(alpha, beta, sigma)``, in order of evaluation."""
        return [(a, b, s) for s in self.sigma for b in self.beta for a in self.alpha]

    def level_count(self, beta: float) -> int:
        """Return the number of tonal levels at `beta`."""
        low, high = self.bounds
        if self.convention == "released":
            return round((high - low) / beta)
        # The slack keeps 1 / 0.1 + 8 from becoming 18.000000000000004 and thus 20 levels.
        return math.ceil((high - low) / beta + 2 * self.tails - 1e-9) + 1

    def spacing(self, beta: float) -> float:
        """Return the distance between two levels, in units of intensity."""
        if self.convention == "released":
            low, high = self.bounds
            return (high - low + 2 * self.tails * beta) / self.level_count(beta)
        return beta

    def levels(self, beta: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return the intensities k_i of the tonal levels: float64, shape (L,), increasing."""
        low, high = self.bounds
        count = self.level_count(beta)
        steps = np.arange(count, dtype=np.float64) - (count - 1) / 2
        return 0.5 * (low + high) + self.spacing(beta) * steps

    def mass(self, beta: float) -> float:
        """Return the factor of a density before accumulation: the spacing, or 1 as released."""
        return 1.0 if self.convention == "released" else self.spacing(beta)

    def level_weight(self, beta: float) -> float:
        """Return the weight of one level in the distance of two histograms."""
        return 1.0 / self.level_count(beta) if self.convention == "released" else self.spacing(beta)

    @property
    def scale_weight(self) -> float:
        """Weight of one scale in the total: 1, or one over their number as released."""
        return 1.0 / len(self.keys) if self.convention == "released" else 1.0


def _check_size(height: int, width: int) -> None:
    for name, size in (("height", height), ("width", width)):
        if (whole_number(size) or 0) < 1:
            msg = f"`{name}` must be a whole number of pixels, 1 or more, got {shown(size)}"
            raise ScaleError(msg)


def _sigma_line(sigma: float) -> str:
    if sigma == 0.0:
        return "sigma 0 px: no blur"
    if sigma <= 1.0:
        return f"sigma {sigma:g} px: keeps the resolution of the pixels, and gives edges between them a slope"
    return f"sigma {sigma:g} px: averages away features narrower than about {2.0 * sigma:g} px"


def _odd(taps: int) -> int:
    return taps if taps % 2 else taps + 1


def _number(name: str, value: object, *, zero: bool) -> float:
    number = real_number(value)
    if not math.isfinite(number) or number < 0 or (number == 0 and not zero):
        msg = f"`{name}` must be a finite number, {'0 or more' if zero else 'more than 0'}, got {shown(value)}"
        raise ScaleError(msg)
    return number


def _scales(name: str, values: object, *, zero: bool) -> tuple[float, ...]:
    if not isinstance(values, Iterable) or isinstance(values, str | bytes) or getattr(values, "shape", None) == ():
        values = (values,)
    scales = tuple(_number(name, value, zero=zero) for value in values)
    if not scales:
        msg = f"`{name}` must hold at least one scale, got {shown(values)}"
        raise ScaleError(msg)
    if len(set(scales)) != len(scales):
        msg = f"`{name}` must not repeat a scale, got {shown(values)}"
        raise ScaleError(msg)
    return scales


def _bounds(bounds: object) -> tuple[float, float]:
    low = high = math.nan
    if isinstance(bounds, Iterable) and not isinstance(bounds, str | bytes):
        values = [real_number(value) for value in bounds]
        if len(values) == 2:
            low, high = values
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        msg = f"`bounds` must be two finite intensities (low, high) with low < high, got {shown(bounds)}"
        raise ScaleError(msg)
    return low, high


def _choice(name: str, value: object, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        msg = f"`{name}` must be one of {', '.join(map(repr, allowed))}, got {shown(value)}"
        raise ScaleError(msg)
    return value


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool | np.bool_):
        msg = f"`{name}` must be True or False, got {shown(value)}"
        raise ScaleError(msg)
    return bool(value)


def _kernel_size(kernel_size: object, convention: str) -> int | None:
    if convention != "released":
        if kernel_size is not None:
            msg = f"`kernel_size` goes with the released convention only, got {shown(kernel_size)}"
            raise ScaleError(msg)
        return None
    taps = whole_number(kernel_size)
    if taps is None or taps < 1:
        msg = f"`kernel_size` must be a whole number of taps, 1 or more, got {shown(kernel_size)}"
        raise ScaleError(msg)
    return taps

"""The scale space of a locally orderless image: which sigma, beta and alpha are compared, and on which levels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from loi_core.errors import ScaleError
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

MAX_LEVELS: Final = 2**16  # more than 16 bits hold; a finer beta is a slip, and would ask for terabytes
RELEASED_TAILS: Final = 4.0  # the released code spreads its levels over [-4 beta, 1 + 4 beta]


LEVELS: Final = 8.0  # tonal scales in the bounds, unless they are given
FAR_BLUR: Final = 0.125  # of the longer side: the inner scale from which a fit begins

REACH: Final = 6.07
"""How far a small object alone is felt, in units of what blurs it: there, the slope of the loss is 1 % of its steepest.

Two Gaussians of a scale s a distance d apart differ by 2 erf(d / (sqrt(8) s)), whose slope falls as
exp(-d**2 / (8 s**2)); s**2 is the sum of the squares of alpha and sigma.
"""

WHOLE: Final = 0.97
"""An extent of so many sides tells places apart by less than 1 %: exp(-(pi WHOLE)**2 / 2), see docs/mathematics.md."""

BOUNDARIES: Final[dict[str, str]] = {
    "reflect": "boundary reflect: the image is mirrored at its border, so that nothing is lost there",
    "zero": "boundary zero: black lies around the image, and the loss may fall as objects leave the frame",
}


@dataclass(frozen=True, init=False)
class ScaleSpace:
    """The scales at which two images are compared, and the rules that go with them.

    Parameters
    ----------
    sigma : float or sequence of float
        Inner scales: standard deviations, in pixels, of the blur of the image (eq. 1). 0 leaves it as it is.
    alpha : float or sequence of float
        Extent scales: standard deviations, in pixels, of the neighbourhood of a histogram (eq. 4).
        0 compares pixel by pixel.
    beta : float or sequence of float
        Tonal scales: standard deviations, in units of intensity, of the uncertainty of a pixel (eq. 3).
    bounds : (float, float)
        Least and greatest intensity that is told apart. Values outside count as the bound itself; their
        gradient is kept where it points back inside.
    boundary : {"reflect", "zero"}
        What lies outside the image. "reflect" mirrors at the edge of the border pixels and conserves mass;
        "zero" is black, or the bound nearest to it; it loses mass at the border, and objects leave the frame.
    p : float
        Order of the distance between two cumulative histograms, ``|difference| ** (1 / p)`` (eq. 5).
    tails : float
        How far, in units of beta, the levels reach beyond `bounds`, so that a saturated pixel keeps its mass.
    convention : {"paper", "released"}
        How histograms are normalised; see :meth:`released`, which is how to ask for the second.
    kernel_size : int, optional
        Taps of the extent kernels; only with, and needed by, the released convention.

    Raises
    ------
    ScaleError
        If a value is not allowed. The message names the argument, what came and what is allowed.
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
    ) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("sigma", _scales("sigma", sigma, zero=True))
        put("alpha", _scales("alpha", alpha, zero=True))
        put("beta", _scales("beta", beta, zero=False))
        put("bounds", _bounds(bounds))
        put("boundary", _choice("boundary", boundary, get_args(Boundary)))
        put("p", _number("p", p, zero=False))
        put("tails", _number("tails", tails, zero=True))
        put("convention", _choice("convention", convention, get_args(Convention)))
        put("kernel_size", _kernel_size(kernel_size, convention))
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
        """The scales that the paper used for vector graphics, path tracing or rasterization.

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
        """Scales that reach across an image of this size: one fine image, seen through wide neighbourhoods.

        The inner scale is 1 pixel. The widest extent is 0.35 of the longer side (45 pixels at 128), the others a
        third and a ninth of it. Wide inner scales would average appearance away, and narrow extents would hold
        objects fast in places that only nearly fit; neither is needed to reach far. The tonal scale is an eighth of
        the bounds.
        """
        _check_size(height, width)
        widest = 0.35 * max(height, width)
        extents = [round(widest / share, 2) for share in (9, 3, 1)]
        if beta is None:
            low, high = _bounds(bounds)
            beta = (high - low) / LEVELS
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
        """Scales for the stages of a fit on images of this size, from those that reach far to those of `for_image`.

        Textures hold objects fast where they happen to fit, the more the narrower the scales. An inner scale of an
        eighth of the longer side averages them away, and what is left is seen from far.
        """
        near = cls.for_image(height, width, beta=beta, bounds=bounds, boundary=boundary)
        blur = round(FAR_BLUR * max(height, width), 2)
        if blur <= near.sigma[0]:
            return (near,)
        return cls((*near.sigma, blur), near.alpha[-2:], near.beta, bounds, boundary), near

    @classmethod
    def released(
        cls, sigma: float | Iterable[float], alpha: float | Iterable[float], bins: int, kernel_size: int
    ) -> ScaleSpace:
        """The conventions of the code that the paper's authors released, to reproduce their numbers.

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
        """Which scales these are, what each of them does to images of this size, and why: lines to print.

        Parameters
        ----------
        height, width : int
            Size of the images, in pixels.

        Returns
        -------
        str
            A line for where the scales come from, one for every sigma, beta and alpha, and one for every rule.

        Raises
        ------
        ScaleError
            If the size is not of whole pixels, 1 or more.

        Examples
        --------
        >>> print(ScaleSpace.for_image(96, 128).describe(96, 128).splitlines()[0])
        ScaleSpace.for_image(96, 128): a fine image, seen through wide neighbourhoods
        """
        _check_size(height, width)
        ours, source = self._source(height, width)
        low, high = self.bounds
        lines = [source, *(_told_sigma(sigma) for sigma in self.sigma)]
        if ours:
            lines[-1] += "; a wider blur would average appearance away, and extents see to the reach"
        for beta in self.beta:
            levels = self.levels(beta)
            eighth = ", an eighth of the bounds" if math.isclose(beta * LEVELS, high - low) else ""
            lines.append(
                f"beta {beta:g}{eighth}: intensities that differ by about as much are told apart; {len(levels)} levels "
                f"from {levels[0]:g} to {levels[-1]:g}, and time grows with their number"
            )
        lines += [self._told_alpha(alpha, max(height, width)) for alpha in self.alpha]
        lines.append(
            f"bounds {low:g} to {high:g}: what lies beyond counts as the bound; of its gradient, what points back stays"
        )
        lines.append(BOUNDARIES[self.boundary])
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

    def _told_alpha(self, alpha: float, longer: int) -> str:
        if alpha == 0.0:
            return "alpha 0 px: pixel by pixel, so that only what overlaps once it is blurred is felt"
        reached = REACH * math.hypot(alpha, max(self.sigma))
        if self.extent_taps is not None and self.inner_taps is not None:
            # Two neighbourhoods that are cut have nothing in common beyond the sum of their radii.
            reached = min(reached, self.extent_taps + self.inner_taps - 2.0)
        if alpha >= WHOLE * longer:
            felt = "the histogram is nearly the same everywhere, and hardly tells places apart"
        elif reached >= longer:
            felt = "a small object alone is felt from everywhere in the image"
        else:
            felt = f"a small object alone is felt from up to about {reached:.0f} px away"
        return f"alpha {alpha:g} px, {alpha / longer:.2g} of the longer side: {felt}"

    def _source(self, height: int, width: int) -> tuple[bool, str]:
        """Whether these are the scales of `for_image`, and what to call them."""
        if self == ScaleSpace.for_image(height, width, beta=self.beta[0], bounds=self.bounds, boundary=self.boundary):
            return True, f"ScaleSpace.for_image({height}, {width}): a fine image, seen through wide neighbourhoods"
        for preset, scales in PAPER_PRESETS.items():
            if self == ScaleSpace(scales["sigma"], scales["alpha"], scales["beta"], self.bounds, self.boundary):
                return False, f"ScaleSpace.paper({preset!r}): what the paper used, whatever the size of the image"
        return False, f"scales of your own, for {width} x {height} pixels"

    @property
    def padding(self) -> float:
        """The intensity within the bounds that is nearest to 0: what lies outside the image under the boundary "zero".

        Images are compared relative to it under either boundary, so that bounds far from 0 cost no accuracy.
        """
        return min(max(0.0, self.bounds[0]), self.bounds[1])

    @property
    def inner_taps(self) -> int | None:
        """Taps of the inner kernels; None for as many as matter in float64."""
        return None if self.kernel_size is None else _odd(max(3, int(4 * max(self.sigma))))

    @property
    def extent_taps(self) -> int | None:
        """Taps of the extent kernels; None for as many as matter in float64."""
        return None if self.kernel_size is None else _odd(self.kernel_size)

    @property
    def keys(self) -> list[tuple[float, float, float]]:
        """Every ``(alpha, beta, sigma)`` that is compared, in the order in which it is evaluated."""
        return [(a, b, s) for s in self.sigma for b in self.beta for a in self.alpha]

    def level_count(self, beta: float) -> int:
        """Number of tonal levels at `beta`."""
        low, high = self.bounds
        if self.convention == "released":
            return round((high - low) / beta)
        # The small slack keeps 1 / 0.1 + 8 from becoming 18.000000000000004 and so 20 levels.
        return math.ceil((high - low) / beta + 2 * self.tails - 1e-9) + 1

    def spacing(self, beta: float) -> float:
        """Distance between two levels, in units of intensity."""
        if self.convention == "released":
            low, high = self.bounds
            return (high - low + 2 * self.tails * beta) / self.level_count(beta)
        return beta

    def levels(self, beta: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """The intensities k_i at which histograms are sampled: float64, shape (L,), increasing."""
        low, high = self.bounds
        count = self.level_count(beta)
        steps = np.arange(count, dtype=np.float64) - (count - 1) / 2
        return 0.5 * (low + high) + self.spacing(beta) * steps

    def mass(self, beta: float) -> float:
        """What a density is multiplied by before it is accumulated: the spacing, or 1 as released."""
        return 1.0 if self.convention == "released" else self.spacing(beta)

    def level_weight(self, beta: float) -> float:
        """Weight of one level in the distance of two histograms."""
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


def _told_sigma(sigma: float) -> str:
    if sigma == 0.0:
        return "sigma 0 px: pixels as they are"
    if sigma <= 1.0:
        return f"sigma {sigma:g} px: the image stays as fine as its pixels, and edges between them get a slope"
    return f"sigma {sigma:g} px: what is narrower than about {2.0 * sigma:g} px is averaged away"


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

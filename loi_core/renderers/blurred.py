"""Gradients by blurring in parameter space, of any renderer's images (Fischer and Ritschel, CVPR 2023)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.contract import (
    Loss,
    LossPullback,
    Parameters,
    Pullback,
    Renderer,
    RendererCapabilities,
    capabilities_of,
    render_loss_vjp,
)
from loi_core.renderers.units import measure_units, pixels_of
from loi_core.support.arrays import Array, detached, from_numpy, namespace, to_numpy
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["BLUR_KEYS", "BlurredRenderer", "Sigma", "names_to_blur"]

HALF: Final = 0.5  # of the steps: until then sigma is held
USUAL: Final = "2 px"
LAST: Final = 0.5  # of sigma, where it goes
BLUR_KEYS: Final = ("sigma", "final_sigma", "names", "pairs", "together", "compare")
"""What can be said of a blur, as in the table `blur` of a scene file."""

Width: TypeAlias = float | str
Compared: TypeAlias = Literal["images", "losses", "both"]
_Judge: TypeAlias = Callable[[Array, Array], float]
Sigma: TypeAlias = Width | Mapping[str, Width]
"""A standard deviation, in a parameter's own unit or in pixels ("2 px"); or such by parameter."""


class BlurredRenderer:
    """A renderer whose pullback is that of its image blurred over its parameters; the image itself is sharp.

    Where a parameter has no gradient, or one that is 0 all around, its blur by a Gaussian has one: the mean of images
    at drawn parameters, times the derivative of the Gaussian. Each draw renders an antithetic pair, at both sides.

    Parameters
    ----------
    renderer : Renderer
        Only its images are used for what is blurred.
    sigma : float, str, or dict of these
        Standard deviations of the blur, more than 0, in each parameter's own unit, or in pixels that the image moves
        ("2 px"), for which every unit is measured where the renderer has the parameters: one for all, or by name.
    final_sigma : float, str, or dict of these, optional
        Where `sigma` goes, along a line, over the second half of a fit; half of `sigma` by default.
    names : names of parameters, optional
        Those that are blurred; all by default. Others have the gradient of `renderer` itself, in the same fit.
    pairs : int
        Pairs of images of one gradient; with `together` False, for each number.
    together : bool, optional
        Whether all numbers are drawn at once, from Gaussians, so that a pair of images serves all. Otherwise each has
        pairs of its own, whose offset by that number is drawn where the derivative of the Gaussian is large. One number
        alone is drawn so by default; of several, images that serve all are worth more.
    compare : {"images", "losses", "both"}
        What of a pair is compared, where the loss is known; see below.

    Notes
    -----
    Both images of a pair share a seed, so that most of a renderer's own noise cancels. If `renderer` has ``project``,
    drawn parameters are made legal by it, which pulls the gradient inwards within a few sigma of a bound.

    With `compare` "images", the loss is linearised at the sharp image; with "losses", those of the two images of a pair
    are compared, as in the released code of the paper. The first is more exact near the end, and where the renderer has
    no noise of its own. The second has less noise, and looks further: of something bright that moves on by more than
    its own size, the slope at the sharp image says nothing. "both" is their mean. A :func:`loi_core.fit` passes
    its loss; in a loop of your own, the pullback of :meth:`render_loss_vjp` takes ``(objective.value, cotangent)``. In
    such a loop `sigma` stays the same unless you call `at_step`.

    The offsets of up to as many pairs as there are numbers are at right angles to each other, each of them still from
    a Gaussian: pairs that look in the same direction tell less.

    Raises
    ------
    OptionError
        If an option is not allowed; at the first gradient, if a parameter leaves no trace in the image, which then has
        no pixels to measure.
    ParameterError
        If a name is not one of the renderer's parameters.

    Examples
    --------
    >>> from loi_core.renderers import Disks
    >>> disks = Disks(32, 32, positions=[[8.0, 8.0]], radii=4.0, colours=[[1.0, 1.0, 1.0]])
    >>> blurred = BlurredRenderer(disks, 3.0, names=["positions"])
    >>> image, pullback = blurred.render_vjp(blurred.parameters(), seed=1)
    >>> sorted(pullback(image))
    ['colours', 'positions', 'radii']
    """

    def __init__(
        self,
        renderer: Renderer,
        sigma: Sigma = USUAL,
        *,
        final_sigma: Sigma | None = None,
        names: Iterable[str] | None = None,
        pairs: int = 1,
        together: bool | None = None,
        compare: Compared = "images",
    ) -> None:
        self.renderer = renderer
        if compare not in get_args(Compared):
            msg = f"`compare` must be 'images', 'losses' or 'both', got {shown(compare)}"
            raise OptionError(msg)
        self._compare: Compared = compare
        start = renderer.parameters()
        self.names = names_to_blur(names, start)
        if (whole_number(pairs) or 0) < 1:
            msg = f"`pairs` must be a whole number, 1 or more, got {shown(pairs)}"
            raise OptionError(msg)
        if together is not None and not isinstance(together, bool):
            msg = f"`together` must be true or false, got {shown(together)}"
            raise OptionError(msg)
        self._first = _by_name("sigma", sigma, self.names)
        self._last = None if final_sigma is None else _by_name("final_sigma", final_sigma, self.names)
        self._pairs = int(pairs)
        count = sum(math.prod(start[name].shape) for name in self.names)
        self._together = count > 1 if together is None else together
        self._units: dict[str, float] | None = None
        self._passed = 0.0

    @property
    def sigma(self) -> dict[str, float]:
        """The standard deviations of the blur in this step, each in its parameter's own unit."""
        share = max((self._passed - HALF) / (1.0 - HALF), 0.0)
        first = self._in_own_units("sigma", self._first)
        last = {name: LAST * one for name, one in first.items()}
        if self._last is not None:
            last = self._in_own_units("final_sigma", self._last)
        return {name: (1.0 - share) * own + share * last[name] for name, own in first.items()}

    @property
    def capabilities(self) -> RendererCapabilities:
        """The capabilities of the wrapped renderer, with the blur of each step and gradients of the loss itself."""
        wrapped = capabilities_of(self.renderer)
        return replace(
            wrapped,
            at_step=self.at_step,
            render_loss_vjp=self.render_loss_vjp,
            unabridged=wrapped.unabridged or (lambda: self.renderer),
            planner=None,
        )

    def at_step(self, step: int, steps: int, value: float | None) -> None:
        """Set `sigma` to its value at `step` of `steps`; :func:`loi_core.fit` calls this before every step."""
        self._passed = min(step / max(steps - 1, 1), 1.0)
        wrapped = capabilities_of(self.renderer).at_step
        if wrapped is not None:
            wrapped(step, steps, value)

    def parameters(self) -> Parameters:
        """As the renderer has them."""
        return self.renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """The sharp image, shape (H, W, C)."""
        return self.renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """The sharp image, and the pullback of its blur; which images that takes is decided by `seed`."""
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, LossPullback]:
        """The same, with a pullback that takes the loss, or None, and the cotangent; see `compare`."""
        kept, sigma = dict(params), self.sigma
        sharp: LossPullback | None = None
        if set(self.names) < set(kept):
            image, sharp = render_loss_vjp(self.renderer, params, seed=seed)
        else:
            image = self.renderer.render(params, seed=seed)

        def pullback(loss: Loss | None, cotangent: Array) -> Parameters:
            pulled = {} if sharp is None else dict(sharp(loss, cotangent))
            found = self._blurred(kept, sigma, self._judge(loss, cotangent), seed)
            return {name: found[name] if name in found else pulled[name] for name in kept}

        return image, pullback

    def vjp(self, params: Parameters, cotangent: Array, *, seed: int = 0, loss: Loss | None = None) -> Parameters:
        """What the pullback of `render_vjp` gives for the parameters that are blurred, without an image.

        Of the loss itself, if that is given and losses are compared.
        """
        return self._blurred(dict(params), self.sigma, self._judge(loss, cotangent), seed)

    def _in_own_units(self, option: str, widths: Mapping[str, Width]) -> dict[str, float]:
        """Standard deviations, those in pixels by units that are measured once."""
        in_pixels = [name for name, width in widths.items() if isinstance(width, str)]
        if in_pixels and self._units is None:
            self._units, _ = measure_units([self.renderer], self.parameters(), None, self.names)
        units, found = self._units or {}, {}
        for name, width in widths.items():
            found[name] = pixels_of(width) * units[name] if isinstance(width, str) else width
            if not math.isfinite(found[name]):
                msg = (
                    f"`{option}` of {name!r} is in pixels, and nothing in the image changes with it to count them by; "
                    f"give it in the parameter's own unit"
                )
                raise OptionError(msg)
        return found

    def _judge(self, loss: Loss | None, cotangent: Array) -> _Judge:
        """How much more one image costs than another, by the loss itself or by its slope."""

        def slope(first: Array, second: Array) -> float:
            return float(to_numpy(namespace(first).sum((first - second) * cotangent)))

        if loss is None or self._compare == "images":
            return slope

        def change(first: Array, second: Array) -> float:
            return float(detached(loss(first))) - float(detached(loss(second)))

        if self._compare == "losses":
            return change
        return lambda first, second: 0.5 * (slope(first, second) + change(first, second))

    def _blurred(self, params: Parameters, sigma: Mapping[str, float], judge: _Judge, seed: int) -> Parameters:
        """An unbiased draw of the gradient by what is blurred, before `project`."""
        rng = np.random.default_rng([int(seed), len(self.names)])
        found = {name: np.zeros(params[name].shape) for name in self.names}
        shapes = {name: params[name].shape for name in self.names}
        if self._together:
            for offsets in _across(rng, shapes, self._pairs):
                change = self._change(params, sigma, offsets, judge, rng)
                for name in self.names:
                    # The derivative of a Gaussian over the Gaussian, at an offset of z sigma, is z / sigma.
                    found[name] += 0.5 * change * offsets[name] / sigma[name] / self._pairs
        else:
            for _, name in product(range(self._pairs), self.names):
                for index in np.ndindex(shapes[name]):
                    offsets = {one: rng.standard_normal(shape) for one, shape in shapes.items()}
                    # Offsets of either sign with the density of the derivative's size, z exp(-z^2 / 2) / 2.
                    offsets[name][index] = math.sqrt(-2.0 * math.log(1.0 - rng.random()))
                    change = self._change(params, sigma, offsets, judge, rng)
                    found[name][index] += change / math.sqrt(2.0 * math.pi) / sigma[name] / self._pairs
        return {name: from_numpy(value, params[name]) for name, value in found.items()}

    def _change(
        self,
        params: Parameters,
        sigma: Mapping[str, float],
        offsets: Mapping[str, np.ndarray[Any, Any]],
        judge: _Judge,
        rng: np.random.Generator,
    ) -> float:
        """How much more the loss is on one side of a pair than on the other."""
        seed = int(rng.integers(2**31))
        project = capabilities_of(self.renderer).project
        images = []
        for sign in (1.0, -1.0):
            moved = dict(params)
            for name, offset in offsets.items():
                moved[name] = params[name] + from_numpy(sign * sigma[name] * offset, params[name])
            images.append(self.renderer.render(moved if project is None else project(moved), seed=seed))
        return judge(images[0], images[1])


def _across(
    rng: np.random.Generator, shapes: Mapping[str, tuple[int, ...]], count: int
) -> Iterator[dict[str, np.ndarray[Any, Any]]]:
    """So many offsets, each from a standard Gaussian, at right angles to each other as far as there is room."""
    sizes = [math.prod(shape) for shape in shapes.values()]
    total = sum(sizes)
    for begin in range(0, count, total):
        rows = min(total, count - begin)
        directions, triangle = np.linalg.qr(rng.standard_normal((total, rows)))
        directions = directions * np.sign(np.diag(triangle))  # or else they would favour some
        lengths = np.linalg.norm(rng.standard_normal((rows, total)), axis=1)
        for flat in (directions * lengths).T:
            parts = np.split(flat, np.cumsum(sizes)[:-1])
            yield {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}


def names_to_blur(names: object, start: Mapping[str, Any]) -> tuple[str, ...]:
    """The parameters to blur, each once; all of `start` if none are given.

    Raises
    ------
    OptionError, ParameterError
        If they are no names, or not of `start`.
    """
    if names is None:
        return tuple(start)
    if isinstance(names, str) or not isinstance(names, Iterable):
        msg = f"`names` must be a list of names of parameters, got {shown(names)}"
        raise OptionError(msg)
    found = list(names)
    for name in found or (None,):
        if not isinstance(name, str) or name not in start:
            msg = f"`names` must be of {', '.join(start)}, got {'none' if name is None else shown(name)}"
            raise ParameterError(msg)
    return tuple(dict.fromkeys(found))


def _by_name(option: str, value: object, names: tuple[str, ...]) -> dict[str, Width]:
    """Standard deviations for all of `names`, numbers or texts in pixels."""
    if isinstance(value, Mapping):
        if set(value) != set(names):
            msg = f"`{option}` must have {', '.join(map(repr, names))}, got {', '.join(map(repr, value)) or 'none'}"
            raise OptionError(msg)
        given = {name: value[name] for name in names}
    else:
        given = dict.fromkeys(names, value)
    found: dict[str, Width] = {}
    for name, one in given.items():
        number = pixels_of(one) if isinstance(one, str) else real_number(one)
        if not 0.0 < number < math.inf:
            msg = (
                f"`{option}` of {name!r} must be a finite number, more than 0, or pixels as in '2 px', got {shown(one)}"
            )
            raise OptionError(msg)
        found[name] = one if isinstance(one, str) else number
    return found

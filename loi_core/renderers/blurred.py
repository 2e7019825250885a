"""Gradients of any renderer by blurring in parameter space (Fischer and Ritschel, CVPR 2023)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
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
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["BLUR_KEYS", "BlurredRenderer", "Sigma", "names_to_blur"]

CONSTANT_FRACTION: Final = 0.5  # of the steps, during which sigma is constant
DEFAULT_SIGMA: Final = "2 px"
FINAL_RATIO: Final = 0.5  # default ratio of the final to the first sigma
BLUR_KEYS: Final = ("sigma", "final_sigma", "names", "pairs", "together", "compare")
"""Options of a blur, as in the table `blur` of a scene file."""

Width: TypeAlias = float | str
Compared: TypeAlias = Literal["images", "losses", "both"]
_LossDifference: TypeAlias = Callable[[Array, Array], float]
Sigma: TypeAlias = Width | Mapping[str, Width]
"""A standard deviation in the unit of a parameter or in pixels ("2 px"), or a dict of these by parameter."""


@suggest_keywords
class BlurredRenderer:
    """Renderer with a sharp image and the pullback of the image blurred over the parameters.

    If an image does not depend on a parameter differentiably, or has gradient 0 in a neighbourhood, its convolution
    with a Gaussian over the parameters still has a gradient: the expectation of the image at random parameters times
    the derivative of the Gaussian. Each draw renders an antithetic pair, with offsets of both signs.

    Parameters
    ----------
    renderer : Renderer
        Only its images are used for the blurred parameters.
    sigma : float, str, or dict of these
        Standard deviations of the blur, more than 0, in the unit of each parameter or in pixels of image motion
        ("2 px"); one for all, or by name. Pixels are converted by measured units, at the renderer's own parameters.
    final_sigma : float, str, or dict of these, optional
        Value of `sigma` at the end of a fit, reached linearly over the second half; half of `sigma` by default.
    names : names of parameters, optional
        The blurred parameters; all by default. The others have the gradient of `renderer` itself.
    pairs : int
        Pairs of images per gradient; with `together` False, per scalar.
    together : bool, optional
        Whether all scalars are offset at once, with Gaussian offsets, so that each pair of images serves all of them.
        Otherwise each scalar has its own pairs, and its offset is drawn with importance sampling of the derivative of
        the Gaussian. The default is False for a single scalar and True for several.
    compare : {"images", "losses", "both"}
        Quantity that is compared within a pair, if the loss is known; see below.

    Notes
    -----
    Both images of a pair share a seed, so that most of the renderer's own noise cancels. If `renderer` has ``project``,
    random parameters are projected, which biases the gradient inwards within a few sigma of a bound.

    With `compare` "images", the loss is linearised at the sharp image. With "losses", the losses of the two images of a
    pair are compared, as in the released code of the paper. The first is more exact near the optimum, and for renderers
    without noise. The second has less variance and a longer range: the slope at the sharp image carries no information
    about a bright object that moves by more than its size. "both" is the mean. A :func:`loi_core.fit` passes its loss;
    in your own loop, pass ``(objective.value, cotangent)`` to the pullback of :meth:`render_loss_vjp`. In your own loop
    `sigma` is constant unless you call :meth:`revisit`.

    The offsets of pairs, up to as many as there are scalars, are orthogonal to each other, and each is Gaussian: pairs
    along similar directions are redundant.

    Raises
    ------
    OptionError
        If an option is not allowed; at the first gradient, if sigma is in pixels and a parameter does not change the
        image.
    ParameterError
        If a name is not a parameter of the renderer.

    References
    ----------
    Fischer and Ritschel, Plateau-reduced differentiable path tracing, CVPR 2023.

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
        sigma: Sigma = DEFAULT_SIGMA,
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
        self._units = _Units(renderer, self.names)
        self._progress = 0.0

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviations of the blur in the current step, each in the unit of its parameter."""
        weight = max((self._progress - CONSTANT_FRACTION) / (1.0 - CONSTANT_FRACTION), 0.0)
        first = self._in_parameter_units("sigma", self._first)
        last = {name: FINAL_RATIO * value for name, value in first.items()}
        if self._last is not None:
            last = self._in_parameter_units("final_sigma", self._last)
        return {name: (1.0 - weight) * value + weight * last[name] for name, value in first.items()}

    @property
    def capabilities(self) -> RendererCapabilities:
        """The capabilities of the wrapped renderer, with the blur of each step and gradients of the loss itself."""
        wrapped = capabilities_of(self.renderer)
        return replace(
            wrapped,
            start=None if wrapped.start is None else self.start,
            revisit=self.revisit,
            render_loss_vjp=self.render_loss_vjp,
            unabridged=wrapped.unabridged or (lambda: self.renderer),
            planner=None,
        )

    def with_renderer(self, renderer: Renderer) -> BlurredRenderer:
        """Return the same blur, with the sigmas of this step, of another renderer of the same scene and parameters."""
        changed = copy(self)
        changed.renderer = renderer
        return changed

    def start(self, params: Parameters, cotangent: Array, *, optimise: Iterable[str], seed: int = 0) -> BlurredRenderer:
        """Return this blur of a renderer that is started for the parameters that are not blurred."""
        start, names = capabilities_of(self.renderer).start, [name for name in optimise if name not in self.names]
        if start is None or not names:
            return self
        return self.with_renderer(start(params, cotangent, optimise=names, seed=seed))

    def revisit(
        self,
        step: int,
        steps: int,
        value: float | None = None,
        params: Parameters | None = None,
        cotangent: Array | None = None,
        *,
        seed: int = 0,
    ) -> BlurredRenderer:
        """Return the renderer of `step` of `steps`, with its `sigma`; :func:`loi_core.fit` calls this before each step.

        The other arguments belong to the previous step and are forwarded; see :class:`RendererCapabilities`.
        """
        wrapped = capabilities_of(self.renderer).revisit
        renderer = self.renderer if wrapped is None else wrapped(step, steps, value, params, cotangent, seed=seed)
        changed = self.with_renderer(renderer)
        changed._progress = min(step / max(steps - 1, 1), 1.0)
        return changed

    def parameters(self) -> Parameters:
        """Return the parameters of the wrapped renderer."""
        return self.renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the sharp image, shape (H, W, C)."""
        return self.renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """Return the sharp image and the pullback of its blur, whose random images are determined by `seed`."""
        image, pullback = self.render_loss_vjp(params, seed=seed)
        return image, partial(pullback, None)

    def render_loss_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, LossPullback]:
        """Return the sharp image and a pullback that takes the loss, or None, and the cotangent; see `compare`."""
        params, sigma = dict(params), self.sigma
        unblurred: LossPullback | None = None
        if set(self.names) < set(params):
            image, unblurred = render_loss_vjp(self.renderer, params, seed=seed)
        else:
            image = self.renderer.render(params, seed=seed)

        def pullback(loss: Loss | None, cotangent: Array) -> Parameters:
            gradient = {} if unblurred is None else dict(unblurred(loss, cotangent))
            gradient |= self._draw_gradient(params, sigma, self._loss_difference(loss, cotangent), seed)
            return {name: gradient[name] for name in params}

        return image, pullback

    def vjp(self, params: Parameters, cotangent: Array, *, seed: int = 0, loss: Loss | None = None) -> Parameters:
        """Return the gradient of the blurred parameters without rendering the sharp image.

        `loss` is used if it is not None and losses are compared.
        """
        return self._draw_gradient(dict(params), self.sigma, self._loss_difference(loss, cotangent), seed)

    def _in_parameter_units(self, option: str, widths: Mapping[str, Width]) -> dict[str, float]:
        """Return standard deviations in the units of their parameters; pixels are converted by measured units."""
        converted = {}
        for name, width in widths.items():
            converted[name] = pixels_of(width) * self._units.measured[name] if isinstance(width, str) else width
            if not math.isfinite(converted[name]):
                msg = (
                    f"`{option}` of {name!r} is in pixels, but the image does not change with the parameter; "
                    f"give it in the parameter's own unit"
                )
                raise OptionError(msg)
        return converted

    def _loss_difference(self, loss: Loss | None, cotangent: Array) -> _LossDifference:
        """Return the function that estimates the loss of a first image minus the loss of a second image."""

        def linearised(first: Array, second: Array) -> float:
            return float(to_numpy(namespace(first).sum((first - second) * cotangent)))

        if loss is None or self._compare == "images":
            return linearised

        def exact(first: Array, second: Array) -> float:
            return float(detached(loss(first))) - float(detached(loss(second)))

        if self._compare == "losses":
            return exact
        return lambda first, second: 0.5 * (linearised(first, second) + exact(first, second))

    def _draw_gradient(
        self, params: Parameters, sigma: Mapping[str, float], difference: _LossDifference, seed: int
    ) -> Parameters:
        """Return a draw of the gradient of the blurred parameters; unbiased without `project`."""
        rng = np.random.default_rng([int(seed), len(self.names)])
        gradient = {name: np.zeros(params[name].shape) for name in self.names}
        shapes = {name: params[name].shape for name in self.names}
        if self._together:
            for offsets in _orthogonal_offsets(rng, shapes, self._pairs):
                change = self._pair_difference(params, sigma, offsets, difference, rng)
                for name in self.names:
                    # The logarithmic derivative of a Gaussian at an offset of z sigma is z / sigma, up to its sign.
                    gradient[name] += 0.5 * change * offsets[name] / sigma[name] / self._pairs
        else:
            for _, name in product(range(self._pairs), self.names):
                for index in np.ndindex(shapes[name]):
                    offsets = {key: rng.standard_normal(shape) for key, shape in shapes.items()}
                    # Importance sampling of the derivative: density |z| exp(-z^2 / 2) / 2, with both signs in a pair.
                    offsets[name][index] = math.sqrt(-2.0 * math.log(1.0 - rng.random()))
                    change = self._pair_difference(params, sigma, offsets, difference, rng)
                    gradient[name][index] += change / math.sqrt(2.0 * math.pi) / sigma[name] / self._pairs
        return {name: from_numpy(value, params[name]) for name, value in gradient.items()}

    def _pair_difference(
        self,
        params: Parameters,
        sigma: Mapping[str, float],
        offsets: Mapping[str, np.ndarray[Any, Any]],
        difference: _LossDifference,
        rng: np.random.Generator,
    ) -> float:
        """Return the difference of the loss between the two images of a pair."""
        seed = int(rng.integers(2**31))
        project = capabilities_of(self.renderer).project
        images = []
        for sign in (1.0, -1.0):
            moved = dict(params)
            for name, offset in offsets.items():
                moved[name] = params[name] + from_numpy(sign * sigma[name] * offset, params[name])
            images.append(self.renderer.render(moved if project is None else project(moved), seed=seed))
        return difference(images[0], images[1])


class _Units:
    """The units of parameters for a motion of one pixel, measured when they are first needed."""

    def __init__(self, renderer: Renderer, names: Sequence[str]) -> None:
        self._renderer = renderer
        self._names = names

    @cached_property
    def measured(self) -> dict[str, float]:
        """The unit of each parameter."""
        return measure_units([self._renderer], self._renderer.parameters(), None, self._names)[0]


def _orthogonal_offsets(
    rng: np.random.Generator, shapes: Mapping[str, tuple[int, ...]], count: int
) -> Iterator[dict[str, np.ndarray[Any, Any]]]:
    """Yield `count` standard Gaussian offsets, orthogonal to each other within groups of the dimension."""
    sizes = [math.prod(shape) for shape in shapes.values()]
    total = sum(sizes)
    for first in range(0, count, total):
        rows = min(total, count - first)
        directions, triangle = np.linalg.qr(rng.standard_normal((total, rows)))
        directions = directions * np.sign(np.diag(triangle))  # for uniformly distributed directions
        lengths = np.linalg.norm(rng.standard_normal((rows, total)), axis=1)
        for flat in (directions * lengths).T:
            arrays = np.split(flat, np.cumsum(sizes)[:-1])
            yield {name: array.reshape(shape) for (name, shape), array in zip(shapes.items(), arrays, strict=True)}


def names_to_blur(names: object, start: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the parameters to blur, without duplicates; all names of `start` for None.

    Raises
    ------
    OptionError
        If `names` is not a list of names.
    ParameterError
        If a name is not in `start`.
    """
    if names is None:
        return tuple(start)
    if isinstance(names, str) or not isinstance(names, Iterable):
        msg = f"`names` must be a list of names of parameters, got {shown(names)}"
        raise OptionError(msg)
    listed = list(names)
    for name in listed or (None,):
        if not isinstance(name, str) or name not in start:
            msg = f"`names` must be of {', '.join(start)}, got {'none' if name is None else shown(name)}"
            raise ParameterError(msg)
    return tuple(dict.fromkeys(listed))


def _by_name(option: str, value: object, names: tuple[str, ...]) -> dict[str, Width]:
    """Return the standard deviation of each parameter, a number or a text in pixels."""
    if isinstance(value, Mapping):
        if set(value) != set(names):
            msg = f"`{option}` must have {', '.join(map(repr, names))}, got {', '.join(map(repr, value)) or 'none'}"
            raise OptionError(msg)
        widths = {name: value[name] for name in names}
    else:
        widths = dict.fromkeys(names, value)
    checked: dict[str, Width] = {}
    for name, width in widths.items():
        number = pixels_of(width) if isinstance(width, str) else real_number(width)
        if not 0.0 < number < math.inf:
            expected = "a finite number, more than 0, or pixels as in '2 px'"
            msg = f"`{option}` of {name!r} must be {expected}, got {shown(width)}"
            raise OptionError(msg)
        checked[name] = width if isinstance(width, str) else number
    return checked

"""Gradients by blurring in parameter space, of any renderer's images (Fischer and Ritschel, CVPR 2023)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from loi_core.errors import OptionError, ParameterError
from loi_core.renderers.contract import (
    AbridgedRenderer,
    EncodedRenderer,
    Parameters,
    ProjectingRenderer,
    Pullback,
    Renderer,
)
from loi_core.support.arrays import Array, from_numpy, namespace, to_numpy
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import shown

__all__ = ["BlurredRenderer"]

HALF: Final = 0.5  # of the steps: until then sigma is held

Sigma = float | Mapping[str, float]


class BlurredRenderer:
    """A renderer whose pullback is that of its image blurred over its parameters; the image itself is sharp.

    Where a parameter has no gradient, or one that is 0 all around, its blur by a Gaussian has one: the mean of images
    at drawn parameters, times the derivative of the Gaussian. Each draw renders an antithetic pair, at both sides.

    Parameters
    ----------
    renderer : Renderer
        Only its images are used for what is blurred.
    sigma : float or dict of float
        Standard deviations of the blur, in each parameter's own unit, more than 0: one for all, or by name.
    final_sigma : float or dict of float, optional
        Where `sigma` goes, along a line, over the second half of `steps`; it stays `sigma` by default.
    steps : int, optional
        Of the fit; needed with `final_sigma`, and `watch` as the fit's callback.
    names : names of parameters, optional
        Those that are blurred; all by default. Others have the gradient of `renderer` itself, in the same fit.
    pairs : int
        Pairs of images of one gradient; with `together` False, for each number.
    together : bool, optional
        Whether all numbers are drawn at once, from Gaussians, so that a pair of images serves all. Otherwise each has
        pairs of its own, whose offset by that number is drawn where the derivative of the Gaussian is large. One number
        alone is drawn so by default; of several, images that serve all are worth more.

    Notes
    -----
    Both images of a pair share a seed, so that most of a renderer's own noise cancels. If `renderer` has ``project``,
    drawn parameters are made legal by it, which pulls the gradient inwards within a few sigma of a bound.

    The gradient is of the loss linearised at the sharp image. The released code of the paper compares the losses of a
    pair instead, which is the same to first order in the difference of the two images. A fit that is resumed takes its
    first step with the sigma of the first step of all.

    Raises
    ------
    OptionError
        If an option is not allowed.
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
        sigma: Sigma,
        *,
        final_sigma: Sigma | None = None,
        steps: int | None = None,
        names: Iterable[str] | None = None,
        pairs: int = 1,
        together: bool | None = None,
    ) -> None:
        self.renderer = renderer
        if isinstance(renderer, EncodedRenderer):
            self.encoding = renderer.encoding
        start = renderer.parameters()
        self.names = tuple(start) if names is None else tuple(dict.fromkeys(names))
        for name in self.names:
            if name not in start:
                msg = f"`names` must be of {', '.join(start)}, got {name!r}"
                raise ParameterError(msg)
        if (whole_number(pairs) or 0) < 1:
            msg = f"`pairs` must be a whole number, 1 or more, got {shown(pairs)}"
            raise OptionError(msg)
        if (final_sigma is not None or steps is not None) and (whole_number(steps) or 0) < 1:
            msg = f"`steps` must be a whole number, 1 or more, where there is a `final_sigma`, got {shown(steps)}"
            raise OptionError(msg)
        self._sigma = _by_name("sigma", sigma, self.names)
        self._final = self._sigma if final_sigma is None else _by_name("final_sigma", final_sigma, self.names)
        self._steps, self._pairs = steps or 1, int(pairs)
        count = sum(math.prod(start[name].shape) for name in self.names)
        self._together = count > 1 if together is None else bool(together)
        self._step = 0

    @property
    def sigma(self) -> dict[str, float]:
        """The standard deviations of the blur in this step."""
        share = min(max((self._step / self._steps - HALF) / (1.0 - HALF), 0.0), 1.0)
        return {name: (1.0 - share) * own + share * self._final[name] for name, own in self._sigma.items()}

    @property
    def unabridged(self) -> Renderer:
        """The renderer without its blur, and whole where it knows what that is."""
        return self.renderer.unabridged if isinstance(self.renderer, AbridgedRenderer) else self.renderer

    def watch(self, step: Any, params: Parameters, image: Any) -> None:
        """A callback for :func:`loi_core.fit`, and the renderer's own: `sigma` then is that of the next step."""
        self._step = int(step.step) + 1
        watch = getattr(self.renderer, "watch", None)
        if watch is not None:
            watch(step, params, image)

    def parameters(self) -> Parameters:
        """As the renderer has them."""
        return self.renderer.parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """The sharp image, shape (H, W, C)."""
        return self.renderer.render(params, seed=seed)

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """The sharp image, and the pullback of its blur; which images that takes is decided by `seed`."""
        kept, sigma = dict(params), self.sigma
        sharp: Pullback | None = None
        if set(self.names) < set(kept):
            image, sharp = self.renderer.render_vjp(params, seed=seed)
        else:
            image = self.renderer.render(params, seed=seed)

        def pullback(cotangent: Array) -> Parameters:
            pulled = {} if sharp is None else dict(sharp(cotangent))
            found = self._blurred(kept, sigma, cotangent, seed)
            return {
                name: from_numpy(found[name], value) if name in found else pulled[name] for name, value in kept.items()
            }

        return image, pullback

    def project(self, params: Parameters) -> Parameters:
        """The legal parameters next to these, if the renderer knows them."""
        return self.renderer.project(params) if isinstance(self.renderer, ProjectingRenderer) else dict(params)

    def _blurred(
        self, params: Parameters, sigma: Mapping[str, float], cotangent: Array, seed: int
    ) -> dict[str, np.ndarray[Any, Any]]:
        """An unbiased draw of the gradient by what is blurred, before `project`."""
        rng = np.random.default_rng([int(seed), len(self.names)])
        found = {name: np.zeros(params[name].shape) for name in self.names}
        for _ in range(self._pairs):
            if self._together:
                offsets = {name: rng.standard_normal(params[name].shape) for name in self.names}
                change = self._change(params, sigma, offsets, cotangent, rng)
                for name in self.names:
                    # The derivative of a Gaussian over the Gaussian, at an offset of z sigma, is z / sigma.
                    found[name] += 0.5 * change * offsets[name] / sigma[name] / self._pairs
                continue
            for name in self.names:
                for index in np.ndindex(params[name].shape):
                    offsets = {one: rng.standard_normal(params[one].shape) for one in self.names}
                    # Offsets of either sign with the density of the derivative's size, z exp(-z^2 / 2) / 2.
                    offsets[name][index] = math.sqrt(-2.0 * math.log(1.0 - rng.random()))
                    change = self._change(params, sigma, offsets, cotangent, rng)
                    found[name][index] += change / math.sqrt(2.0 * math.pi) / sigma[name] / self._pairs
        return found

    def _change(
        self,
        params: Parameters,
        sigma: Mapping[str, float],
        offsets: Mapping[str, np.ndarray[Any, Any]],
        cotangent: Array,
        rng: np.random.Generator,
    ) -> float:
        """What the cotangent makes of the difference between the images of a pair."""
        seed = int(rng.integers(2**31))
        images = []
        for sign in (1.0, -1.0):
            moved = dict(params)
            for name, offset in offsets.items():
                moved[name] = params[name] + from_numpy(sign * sigma[name] * offset, params[name])
            images.append(self.renderer.render(self.project(moved), seed=seed))
        xp = namespace(images[0])
        return float(to_numpy(xp.sum((images[0] - images[1]) * cotangent)))


def _by_name(option: str, value: object, names: tuple[str, ...]) -> dict[str, float]:
    """Standard deviations for all of `names`."""
    if isinstance(value, Mapping):
        if set(value) != set(names):
            msg = f"`{option}` must have {', '.join(map(repr, names))}, got {', '.join(map(repr, value)) or 'none'}"
            raise OptionError(msg)
        found = {name: real_number(value[name]) for name in names}
    else:
        found = dict.fromkeys(names, real_number(value))
    for name, one in found.items():
        if not 0.0 < one < math.inf:
            msg = f"`{option}` of {name!r} must be more than 0 and finite, got {shown(value)}"
            raise OptionError(msg)
    return found

"""Renderers and objectives that break the contract in one way each, and sound ones that they derive from."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import array_api_strict
import numpy as np

from loi_core import PixelL2
from loi_core.objectives import Evaluation, PlaneComparison, ReferencePlanes
from loi_core.renderers import Disks

Params = dict[str, Any]


class Sound(Disks):
    """A renderer that keeps the contract; each broken renderer below changes one behaviour."""

    def __init__(self, **options: Any) -> None:
        positions = [[5.3, 9.1], [10.6, 4.4]]
        super().__init__(14, 17, positions, [3.2, 2.4], [[1, 0.5, 0.2], [0.1, 0.4, 0.9]], (0.2, 0.3, 0.1), **options)


class Inert(Sound):
    """A sound renderer with a parameter that has no effect."""

    def parameters(self) -> Params:
        return {**super().parameters(), "inert": np.array([1.0, 2.0])}

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp({name: value for name, value in params.items() if name != "inert"})
        image = image + 0.0 * np.sum(params["inert"])  # a NaN spreads
        return image, lambda g: {**pullback(g), "inert": np.zeros(2)}


class NoParameters(Sound):
    def parameters(self) -> Params:
        return {}


class IntegerParameters(Sound):
    def parameters(self) -> Params:
        return {**super().parameters(), "radii": np.array([3, 2])}


class SharedParameters(Sound):
    def parameters(self) -> Params:
        self.cached = getattr(self, "cached", super().parameters())
        return self.cached


class InternalArrays(Sound):
    """parameters() returns a new dict, but the renderer's internal arrays."""

    def parameters(self) -> Params:
        self.cached = getattr(self, "cached", super().parameters())
        return dict(self.cached)


class SharedImage(Sound):
    """All images share memory."""

    def render(self, params: Params, *, seed: int = 0) -> Any:
        image = super().render(params)
        self.image = getattr(self, "image", image)
        self.image[...] = image
        return self.image


class GradientAtDefaults(Sound):
    """The pullback ignores the parameters and uses the renderer's own."""

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        return super().render_vjp(params)[0], super().render_vjp(self.parameters())[1]


class ReadsLater(Sound):
    """The pullback reads the parameters when it is called, after later writes."""

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        return super().render_vjp(params)[0], lambda g: super(ReadsLater, self).render_vjp(params)[1](g)


class CalledOnce(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        pullbacks = [pullback]
        return image, lambda g: pullbacks.pop()(g)


class HardEdges(Sound):
    """Disks without anti-aliasing: colours have a gradient, positions and radii do not."""

    def owners(self, params: Params) -> Any:
        y, x = np.mgrid[:14, :17] + 0.5
        owner = np.zeros((14, 17), dtype=int)
        for index, (position, radius) in enumerate(zip(params["positions"], params["radii"], strict=True)):
            owner[np.hypot(x - position[0], y - position[1]) < radius] = index + 1
        return owner

    def render(self, params: Params, *, seed: int = 0) -> Any:
        colours = np.concatenate([np.array([[0.2, 0.3, 0.1]]), params["colours"]])
        return colours.astype(params["colours"].dtype)[self.owners(params)]

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        owner = self.owners(params)
        zeros = {name: np.zeros_like(value) for name, value in params.items()}

        def pullback(cotangent: Any) -> Params:
            return {**zeros, "colours": np.stack([cotangent[owner == disk].sum(axis=0) for disk in (1, 2)])}

        return self.render(params), pullback


class FlatImage(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image.reshape(-1, 3), pullback

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return super().render_vjp(params)[0].reshape(-1, 3)


class TwoImages(Sound):
    def render(self, params: Params, *, seed: int = 0) -> Any:
        return 1.01 * super().render(params)


class TransposedAxes(Sound):
    """The pullback swaps x and y of positions."""

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image, lambda g: {k: v[:, ::-1] if k == "positions" else v for k, v in pullback(g).items()}


def scaled(factor: float, name: str | None = None) -> type[Sound]:
    class Scaled(Sound):
        def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
            image, pullback = super().render_vjp(params)
            return image, lambda g: {k: v * factor if name in (None, k) else v for k, v in pullback(g).items()}

    return Scaled


class Scaled:
    """A renderer whose gradients are multiplied by a factor."""

    def __init__(self, renderer: Any, factor: float) -> None:
        self.renderer = renderer
        self.factor = factor

    def parameters(self) -> Params:
        return dict(self.renderer.parameters())

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return self.renderer.render(params, seed=seed)

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = self.renderer.render_vjp(params, seed=seed)
        return image, lambda g: {k: v * self.factor for k, v in pullback(g).items()}


class IgnoredSeed(Sound):
    """The noise does not depend on the seed."""

    noise = itertools.count()

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image + 1e-6 * np.random.default_rng(next(self.noise)).standard_normal(image.shape), pullback


class StaleImage(Sound):
    """Every render returns the first image."""

    def render(self, params: Params, *, seed: int = 0) -> Any:
        if getattr(self, "last", None) is None:
            self.last = super().render(params)
        return self.last


class SlowlyForgets(Sound):
    """An image contains a small fraction of the previous one."""

    def render(self, params: Params, *, seed: int = 0) -> Any:
        image = super().render(params)
        previous, self.previous = getattr(self, "previous", image), image
        return image + 1e-3 * (previous - image)


class MutatesParameters(Sound):
    def render(self, params: Params, *, seed: int = 0) -> Any:
        image = super().render(params)
        params["radii"] += 1e-3
        return image


class MutatesCotangent(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)

        def writing(cotangent: Any) -> Params:
            result = pullback(cotangent)
            cotangent[0, 0, 0] = 0.0
            return result

        return image, writing


class OneParameterOnly(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image, lambda g: {"positions": pullback(g)["positions"]}


class ZeroForOneParameter(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image, lambda g: {**pullback(g), "radii": np.zeros(2)}


class WrongDtype(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        wrong = np.float32 if image.dtype == np.float64 else np.float64
        return image, lambda g: {k: v.astype(wrong) for k, v in pullback(g).items()}


class TwoLibraries(Sound):
    """render and render_vjp return images of different array libraries."""

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return array_api_strict.asarray(super().render(params))


class Affine(Sound):
    """The pullback adds a constant, like a misplaced regulariser."""

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        return image, lambda g: {k: v + v.dtype.type(1e-2) for k, v in pullback(g).items()}


class SharedState(Sound):
    """Every pullback belongs to the last render."""

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, self.last = super().render_vjp(params)
        return image, lambda g: self.last(g)


class PlansInItsPullback(Sound):
    """The first gradient turns off an effect that carries little of the image."""

    planned = False

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)

        def planning(cotangent: Any) -> Any:
            self.planned = True
            return pullback(cotangent)

        return image * image.dtype.type(0.999) if self.planned else image, planning

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return self.render_vjp(params)[0]


class FreezesLater(Sound):
    """Every gradient after the first is 0."""

    gradients = 0

    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        image, pullback = super().render_vjp(params)
        self.gradients += 1
        return image, pullback if self.gradients < 2 else lambda g: {k: 0.0 * v for k, v in pullback(g).items()}

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return Sound.render_vjp(self, params)[0]


class SwallowsNaN(Sound):
    def render_vjp(self, params: Params, *, seed: int = 0) -> Any:
        return super().render_vjp({k: np.nan_to_num(v) for k, v in params.items()})

    def render(self, params: Params, *, seed: int = 0) -> Any:
        return self.render_vjp(params)[0]


BROKEN_RENDERERS: list[tuple[type[Sound], str]] = [
    (NoParameters, "parameters"),
    (IntegerParameters, "parameters"),
    (SharedParameters, "parameters"),
    (InternalArrays, "parameters"),
    (FlatImage, "image"),
    (TwoImages, "image"),
    (TwoLibraries, "image"),
    (IgnoredSeed, "determinism"),
    (StaleImage, "no_memory"),
    (SharedImage, "no_memory"),
    (SlowlyForgets, "no_memory"),
    (PlansInItsPullback, "no_state"),
    (FreezesLater, "no_state"),
    (MutatesParameters, "no_mutation"),
    (MutatesCotangent, "no_mutation"),
    (OneParameterOnly, "gradient"),
    (WrongDtype, "gradient"),
    (Affine, "linearity"),
    (CalledOnce, "linearity"),
    (SharedState, "pullback_memory"),
    (ReadsLater, "pullback_memory"),
    (GradientAtDefaults, "finite_differences"),
    (HardEdges, "edges"),
    (scaled(-1.0), "finite_differences"),
    (scaled(2.0), "finite_differences"),
    (scaled(1.01), "finite_differences"),
    (scaled(0.99), "finite_differences"),
    (scaled(1.01, "radii"), "finite_differences"),
    (TransposedAxes, "finite_differences"),
    (ZeroForOneParameter, "finite_differences"),
    (SwallowsNaN, "non_finite"),
]


class Wrapped:
    """An objective that keeps the contract; each broken objective below changes one behaviour."""

    def __init__(self, reference: Any) -> None:
        self.inner = PixelL2(reference)

    def value(self, image: Any) -> Any:
        return self.inner.value(image)

    def value_and_grad(self, image: Any) -> Any:
        return self.inner.value_and_grad(image)


class PythonFloat(Wrapped):
    def value(self, image: Any) -> Any:
        return float(super().value(image))


class VectorValue(Wrapped):
    def value(self, image: Any) -> Any:
        return np.asarray(super().value(image))[None]


class TwoValues(Wrapped):
    def value(self, image: Any) -> Any:
        return 1.001 * super().value(image)


class FlatGradient(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image)
        return value, gradient.reshape(-1)


class Maximised(Wrapped):
    def value(self, image: Any) -> Any:
        return -super().value(image)

    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image)
        return -value, -gradient


class HalfGradient(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image)
        return value, 0.5 * gradient


class TransposedGradient(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image)
        return value, np.ascontiguousarray(gradient[:, ::-1])


class StaleValue(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image)
        previous, self.previous = getattr(self, "previous", gradient), gradient
        return value, previous if np.shape(previous) == np.shape(gradient) else gradient

    def value(self, image: Any) -> Any:
        value, self.previous = super().value_and_grad(image)
        return value


class SumsBatches(Wrapped):
    def value(self, image: Any) -> Any:
        return super().value(image) * image.dtype.type(np.prod(image.shape[:-3]))


class OneChannel(Wrapped):
    def __init__(self, reference: Any) -> None:
        super().__init__(reference[..., :1])

    def value(self, image: Any) -> Any:
        return super().value(image[..., :1])

    def value_and_grad(self, image: Any) -> Any:
        value, gradient = super().value_and_grad(image[..., :1])
        return value, np.concatenate([gradient, np.zeros_like(image[..., 1:])], axis=-1)


class MutatesImage(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        result = super().value_and_grad(image)
        image[0, 0, 0] = 0.0
        return result


class MutatesReference(Wrapped):
    def __init__(self, reference: Any) -> None:
        super().__init__(reference)
        reference[0, 0, 0] = 0.0


class BorrowedReference(Wrapped):
    def __init__(self, reference: Any) -> None:
        self.borrowed = reference

    @property
    def inner(self) -> Any:
        return PixelL2(self.borrowed)

    @inner.setter
    def inner(self, value: Any) -> None:
        raise NotImplementedError


class NaNReplacedByZero(Wrapped):
    def value(self, image: Any) -> Any:
        return super().value(np.nan_to_num(image))

    def value_and_grad(self, image: Any) -> Any:
        return super().value_and_grad(np.nan_to_num(image))


class NaNIsAKeyError(Wrapped):
    def value_and_grad(self, image: Any) -> Any:
        if np.any(np.isnan(image)):
            raise KeyError(0)
        return super().value_and_grad(image)


class IgnoresWeights(PixelL2):
    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        return super().compare_with(replace(reference, weights=None))


@dataclass(frozen=True)
class UnweightedSlopes(PlaneComparison[str]):
    weighted: PlaneComparison[str]
    unweighted: PlaneComparison[str]

    def compare(self, planes: Any, *, gradient: bool) -> Evaluation[str]:
        slopes = self.unweighted.compare(planes, gradient=gradient).gradient
        return replace(self.weighted.compare(planes, gradient=False), gradient=slopes)


class UnweightedGradient(PixelL2):
    def compare_with(self, reference: ReferencePlanes) -> PlaneComparison[str]:
        unweighted = replace(reference, weights=None)
        return UnweightedSlopes(super().compare_with(reference), super().compare_with(unweighted))


class IgnoresWeightsOfCalls(PixelL2):
    def compare_weighted(self, prepared: PlaneComparison[str], reference: ReferencePlanes) -> PlaneComparison[str]:
        return prepared


BROKEN_OBJECTIVES: list[tuple[Callable[[Any], Any], str]] = [
    (PythonFloat, "value"),
    (VectorValue, "value"),
    (TwoValues, "value_and_grad"),
    (FlatGradient, "value_and_grad"),
    (Maximised, "minimum"),
    (HalfGradient, "finite_differences"),
    (TransposedGradient, "finite_differences"),
    (SumsBatches, "batch"),
    (OneChannel, "channels"),
    (StaleValue, "no_memory"),
    (MutatesImage, "no_mutation"),
    (MutatesReference, "no_mutation"),
    (BorrowedReference, "own_reference"),
    (NaNReplacedByZero, "non_finite"),
    (NaNIsAKeyError, "non_finite"),
    (IgnoresWeights, "weights"),
    (UnweightedGradient, "weights"),
    (IgnoresWeightsOfCalls, "weights"),
]

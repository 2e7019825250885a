"""Noise of a renderer's gradient between seeds, and propagation of image gradient errors to parameters."""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.fitting.parameters import starting_parameters
from loi_core.objectives import LOIObjective
from loi_core.scenes.scene import Scene
from loi_core.support.arrays import Host, from_numpy, to_numpy

__all__ = ["Noise", "ParameterErrors", "is_stochastic", "renderer_noise"]

MIN_SEEDS: Final = 5
MAX_SEEDS: Final = 20


@dataclass(frozen=True)
class Noise:
    """Noise of the gradient that a renderer returns for one seed, as in every step of a fit.

    Attributes
    ----------
    samples : int or None
        Samples per pixel; None if the renderer has no such option.
    seconds : float
        Median duration of a render with its pullback, without the loss.
    seeds : int
        Number of measured seeds.
    parameters : dict of float
        Standard deviation of one seed's gradient relative to the norm of the mean, by parameter. The mean is noisy
        itself, so that large noise is underestimated: n seeds never give more than sqrt(n).
    """

    samples: int | None
    seconds: float
    seeds: int
    parameters: Mapping[str, float]

    @property
    def least(self) -> float | None:
        """Noise of the parameter with the least noise; None if no parameter has a gradient."""
        return min(self.parameters.values(), default=None)


def is_stochastic(scene: Scene) -> bool:
    """Return whether two seeds give different images of a scene."""
    params = starting_parameters(scene.renderer, scene.optimise)
    first, second = (to_numpy(scene.renderer.render(params, seed=scene.fit.seed + k)) for k in (0, 1))
    return not np.array_equal(first, second, equal_nan=True)


def renderer_noise(scene: Scene, seconds: float) -> Noise:
    """Measure the noise of the gradient of the exact loss at the start of a scene.

    Parameters
    ----------
    scene : Scene
        A scene with a stochastic renderer.
    seconds : float
        Time for further seeds after the minimum number.
    """
    objective = LOIObjective(scene.target, scene.scales, tone=scene.tone)
    params = starting_parameters(scene.renderer, scene.optimise)
    gradients: dict[str, list[Host]] = {name: [] for name in scene.optimise}
    times: list[float] = []
    start = time.perf_counter()
    # The first render compiles; it is not timed, and its seed is rendered again.
    for seed in itertools.chain([0], range(MAX_SEEDS)):
        begin = time.perf_counter()
        image, pullback = scene.renderer.render_vjp(params, seed=scene.fit.seed + seed)
        rendered = time.perf_counter()
        _, cotangent = objective.value_and_grad(image)
        compared = time.perf_counter()
        gradient = {name: to_numpy(value) for name, value in pullback(cotangent).items() if name in gradients}
        times.append(time.perf_counter() - compared + rendered - begin)
        for name, value in gradient.items():
            gradients[name].append(np.array(value, dtype=np.float64))
        if len(times) > MIN_SEEDS and time.perf_counter() - start > seconds:
            break
    noise = {name: _relative_deviation(np.stack(values[1:])) for name, values in gradients.items()}
    finite = {name: value for name, value in noise.items() if np.isfinite(value)}
    return Noise(scene.samples, statistics.median(times[1:]), len(times) - 1, finite)


def _relative_deviation(gradients: Host) -> float:
    """Return the standard deviation over the first axis relative to the norm of the mean; NaN for a mean of 0."""
    mean = float(np.linalg.norm(np.mean(gradients, axis=0)))
    deviation = float(np.sqrt(np.sum(np.var(gradients, axis=0, ddof=1))))
    return deviation / mean if mean > 0.0 else float("nan")


class ParameterErrors:
    """Errors of a scene's parameter gradients that follow from errors of the image gradient.

    Image gradients pass the tone curve of the scene and the pullback of one render.

    Parameters
    ----------
    scene : Scene
    exact : array, shape (H, W, C)
        The exact gradient with respect to the image after the tone curve.
    """

    def __init__(self, scene: Scene, exact: Host) -> None:
        params = starting_parameters(scene.renderer, scene.optimise)
        self._image, self._pullback = scene.renderer.render_vjp(params, seed=scene.fit.seed)
        self._names = tuple(scene.optimise)
        self._tone = scene.tone
        self._exact = self._parameter_gradients(exact)

    def largest(self, gradient: Host) -> float | None:
        """Return the largest relative error, 2-norm, among the parameters; None if none has a gradient."""
        errors = []
        for name, value in self._parameter_gradients(gradient).items():
            norm = float(np.linalg.norm(self._exact[name]))
            if norm > 0.0:
                errors.append(float(np.linalg.norm(value - self._exact[name])) / norm)
        return max(errors, default=None)

    def _parameter_gradients(self, gradient: Host) -> dict[str, Host]:
        cotangent = from_numpy(gradient, self._image)
        if self._tone is not None:
            cotangent = self._tone.pullback(self._image, cotangent)
        gradients = self._pullback(cotangent)
        return {name: np.array(to_numpy(gradients[name]), dtype=np.float64) for name in self._names}

"""How much a renderer's own gradient changes from seed to seed, and what an error of the loss makes in it."""

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

__all__ = ["Noise", "PulledBack", "is_stochastic", "renderer_noise"]

FEWEST_SEEDS: Final = 5
MOST_SEEDS: Final = 20


@dataclass(frozen=True)
class Noise:
    """Noise of the gradient that a renderer gives for one seed, as every step of a fit does.

    Attributes
    ----------
    samples : int or None
        Samples per pixel; None if the renderer takes no such option.
    seconds : float
        Median time of a render with its pullback, without the loss.
    seeds : int
        How many were measured.
    parameters : dict of float
        By parameter, the standard error of one seed's gradient over the norm of the mean. The mean is noisy itself,
        so that great noise is underestimated: n seeds never show more than sqrt(n).
    """

    samples: int | None
    seconds: float
    seeds: int
    parameters: Mapping[str, float]

    @property
    def least(self) -> float | None:
        """That of the parameter which is known best; None if no parameter has a gradient."""
        return min(self.parameters.values(), default=None)


def is_stochastic(scene: Scene) -> bool:
    """Whether a scene renders differently with another seed."""
    params = starting_parameters(scene.renderer, scene.optimise)
    first, second = (to_numpy(scene.renderer.render(params, seed=scene.fit.seed + k)) for k in (0, 1))
    return not np.array_equal(first, second, equal_nan=True)


def renderer_noise(scene: Scene, seconds: float) -> Noise:
    """Noise of the gradient of the exact loss by the scene's parameters, where the scene starts.

    Parameters
    ----------
    scene : Scene
        With a renderer that uses its seed.
    seconds : float
        How long to try further seeds, once there are a few.
    """
    objective = LOIObjective(scene.target, scene.scales, tone=scene.tone)
    params = starting_parameters(scene.renderer, scene.optimise)
    gradients: dict[str, list[Host]] = {name: [] for name in scene.optimise}
    times: list[float] = []
    start = time.perf_counter()
    # The first render compiles; it is not timed, and its seed is drawn again.
    for seed in itertools.chain([0], range(MOST_SEEDS)):
        begin = time.perf_counter()
        image, pullback = scene.renderer.render_vjp(params, seed=scene.fit.seed + seed)
        rendered = time.perf_counter()
        _, slope = objective.value_and_grad(image)
        compared = time.perf_counter()
        pulled = {name: to_numpy(value) for name, value in pullback(slope).items() if name in gradients}
        times.append(time.perf_counter() - compared + rendered - begin)
        for name, value in pulled.items():
            gradients[name].append(np.array(value, dtype=np.float64))
        if len(times) > FEWEST_SEEDS and time.perf_counter() - start > seconds:
            break
    noises = {name: _relative_spread(np.stack(values[1:])) for name, values in gradients.items()}
    known = {name: noise for name, noise in noises.items() if np.isfinite(noise)}
    return Noise(scene.samples, statistics.median(times[1:]), len(times) - 1, known)


def _relative_spread(gradients: Host) -> float:
    """Standard deviation over the first axis by the norm of the mean; NaN if that is 0."""
    mean = float(np.linalg.norm(np.mean(gradients, axis=0)))
    spread = float(np.sqrt(np.sum(np.var(gradients, axis=0, ddof=1))))
    return spread / mean if mean > 0.0 else float("nan")


class PulledBack:
    """Carries errors of an image's gradient to a scene's parameters, through tone curve and one render's pullback."""

    def __init__(self, scene: Scene, gradient: Host) -> None:
        params = starting_parameters(scene.renderer, scene.optimise)
        self._image, self._pullback = scene.renderer.render_vjp(params, seed=scene.fit.seed)
        self._names = tuple(scene.optimise)
        self._tone = scene.tone
        self._wanted = self._pulled(gradient)

    def error(self, gradient: Host) -> float | None:
        """Largest relative error, 2-norm, among the parameters; None if none has a gradient."""
        errors = []
        for name, pulled in self._pulled(gradient).items():
            size = float(np.linalg.norm(self._wanted[name]))
            if size > 0.0:
                errors.append(float(np.linalg.norm(pulled - self._wanted[name])) / size)
        return max(errors, default=None)

    def _pulled(self, gradient: Host) -> dict[str, Host]:
        cotangent = from_numpy(gradient, self._image)
        if self._tone is not None:
            cotangent = self._tone.pullback(self._image, cotangent)
        pulled = self._pullback(cotangent)
        return {name: np.array(to_numpy(pulled[name]), dtype=np.float64) for name in self._names}

"""Measurements of the one-dimensional figures: the basin of every method, and the gradient's support by inner scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.paper.figures.landscapes import (
    NEAR_DISTANCE_PX,
    REACHED_DISTANCE_PX,
    Descents,
    Landscape,
    descend,
    landscape,
)
from examples.paper.figures.signals import Host
from examples.paper.lib.methods import METHODS, SIGMAS, sigma_method
from examples.paper.lib.problems import Problem
from loi_core.method.blurs import gaussian_blur

__all__ = ["FINISHED", "Basin", "Support", "blurred", "measure", "measure_two", "supports"]

FINISHED: Final = "loi, then pixel L2"
MIN_CHANGE_SHARE: Final = 0.01  # of the greatest change: pixels with less change carry no gradient


@dataclass(frozen=True)
class Basin:
    """Basin of attraction of one method for the target of one problem, against one reference.

    Attributes
    ----------
    problem, method : str
    seed : int
        Seed of the noise on the reference.
    found, near : float
        Share of all starts whose descent ends within 0.1 and 0.5 pixels of the target.
    left, right : float
        Width of the basin to either side of the target, in pixels, for descents that end within 0.1 pixels; NaN for
        several parameters.
    offset : float
        Signed distance from the target to the endpoint of descent from next to it, in pixels; NaN for several
        parameters.
    """

    problem: str
    method: str
    seed: int
    found: float
    near: float
    left: float = np.nan
    right: float = np.nan
    offset: float = np.nan

    @classmethod
    def of(cls, problem: Problem, method: str, seed: int, descents: Descents) -> Basin:
        """Return the basin that descents show."""
        left, right = descents.basin(REACHED_DISTANCE_PX)
        reached_share, near_share = descents.share(REACHED_DISTANCE_PX), descents.share(NEAR_DISTANCE_PX)
        return cls(problem.name, method, seed, reached_share, near_share, -left, right, descents.offset)


def measure(problem: Problem) -> Iterator[tuple[Basin, Landscape]]:
    """Yield the basin and the landscape of every method on a problem of one parameter.

    The last basin belongs to ``loi`` followed by pixel L2, with the landscape of ``loi``.
    """
    for seed in range(problem.seeds):
        landscapes: dict[str, Landscape] = {}
        for method in METHODS:
            comparison = method.against(problem.reference(seed))
            method_landscape = landscape(problem.objects, comparison, problem.target[0], problem.spacing)
            landscapes[method.name] = method_landscape
            yield Basin.of(problem, method.name, seed, method_landscape.descents), method_landscape
        loi, pixels = landscapes["loi, for_image"], landscapes["pixel L2"]
        yield Basin.of(problem, FINISHED, seed, loi.descents.followed_by(pixels.descents)), loi


def measure_two(problem: Problem, count: int, steps: int) -> dict[str, tuple[Host, Host]]:
    """Return starts and endpoints of every method on a problem of several parameters, from `count` random starts."""
    lower, upper = problem.objects.bounds
    starts = np.random.default_rng(0).uniform(lower, upper, (count, len(lower)))
    reference = problem.reference()
    return {
        method.name: (starts, descend(problem.objects, method.against(reference), starts, steps)) for method in METHODS
    }


@dataclass(frozen=True)
class Support:
    """Support of the gradient at one inner scale.

    Attributes
    ----------
    sigma : float
        Inner scale, in pixels.
    pixels : float
        Share of pixels that change with the parameter at the problem's start, by 1 % of the greatest change or more.
    basins : tuple of Basin
        Basin of matching at this scale alone, for each problem.
    """

    sigma: float
    pixels: float
    basins: tuple[Basin, ...]


def supports(problems: Sequence[Problem]) -> Iterator[Support]:
    """Yield the support without a blur, then at every inner scale of the paper."""
    for sigma in (0.0, *SIGMAS):
        basins = []
        for problem in problems:
            comparison = sigma_method(sigma).against(problem.reference())
            sigma_landscape = landscape(problem.objects, comparison, problem.target[0], problem.spacing)
            basins.append(Basin.of(problem, f"sigma {sigma:g}", 0, sigma_landscape.descents))
        change = np.abs(blurred(problems[0], sigma)[1])
        yield Support(sigma, float(np.mean(change >= MIN_CHANGE_SHARE * change.max())), tuple(basins))


def blurred(problem: Problem, sigma: float) -> tuple[Host, Host, Host]:
    """Blur the signals of a problem and differentiate the signal at its start.

    Returns
    -------
    signal, derivative, reference : arrays, shape (W,)
        The signal at the start, its central difference with respect to the first parameter, and the reference: the
        middle rows of blurred pictures.
    """
    step = 1e-4
    params = np.array([problem.start, [problem.start[0] + step], [problem.start[0] - step]])
    images = problem.objects.images(params)
    height, width = images.shape[1:]
    blur = gaussian_blur(height, width, sigma, "reflect", like=images)
    start, forward, backward = blur.apply(images)[:, height // 2]
    reference = blur.apply(problem.reference()[None])[0, height // 2]
    return start, (forward - backward) / (2.0 * step), reference

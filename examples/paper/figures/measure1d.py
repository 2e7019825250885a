"""What the one-dimensional figures measure: basins of every method, and the support of the gradient by sigma."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from examples.paper.figures.landscapes import FOUND, NEAR, Descents, Landscape, descend, landscape
from examples.paper.figures.signals import Host
from examples.paper.lib.methods import METHODS, SIGMAS, sigma_method
from examples.paper.lib.problems import Problem
from loi_core.method.blurs import gaussian_blur

__all__ = ["FINISHED", "Basin", "Support", "blurred", "measure", "measure_two", "supports"]

FINISHED: Final = "loi, then pixel L2"
SUPPORTED: Final = 0.01  # of the greatest change: pixels that change by less carry no gradient


@dataclass(frozen=True)
class Basin:
    """How well one method finds the target of one problem, against one reference.

    Attributes
    ----------
    problem, method : str
    seed : int
        Of the reference's noise.
    found, near : float
        Share of all starts from which descent ends within 0.1 and 0.5 pixels of the target.
    left, right : float
        How far to both sides of the target starts reach that end within 0.1 pixels, in pixels; NaN if there are
        several parameters.
    offset : float
        From the target to where descent from next to it ends, in pixels; likewise.
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
        """What these descents show."""
        left, right = descents.basin(FOUND)
        return cls(
            problem.name, method, seed, descents.share(FOUND), descents.share(NEAR), -left, right, descents.offset
        )


def measure(problem: Problem) -> Iterator[tuple[Basin, Landscape]]:
    """Every method on a problem of one parameter; the last is one of ours with pixel L2 after it, on its landscape."""
    for seed in range(problem.seeds):
        found: dict[str, Landscape] = {}
        for method in METHODS:
            comparison = method.against(problem.reference(seed))
            found[method.name] = landscape(problem.movers, comparison, problem.target[0], problem.spacing)
            yield Basin.of(problem, method.name, seed, found[method.name].descents), found[method.name]
        ours, pixels = found["loi, for_image"], found["pixel L2"]
        yield Basin.of(problem, FINISHED, seed, ours.descents.followed_by(pixels.descents)), ours


def measure_two(problem: Problem, count: int, steps: int) -> dict[str, tuple[Host, Host]]:
    """Starts and ends of every method on a problem of several parameters, from the same `count` random starts."""
    low, high = problem.movers.bounds
    starts = np.random.default_rng(0).uniform(low, high, (count, len(low)))
    reference = problem.reference()
    return {one.name: (starts, descend(problem.movers, one.against(reference), starts, steps)) for one in METHODS}


@dataclass(frozen=True)
class Support:
    """What one inner scale does to the gradient.

    Attributes
    ----------
    sigma : float
        In pixels.
    pixels : float
        Share of pixels that change with the parameter at the problem's start, by 1 % of the greatest change or more.
    basins : tuple of Basin
        Of matching at this scale alone, by problem.
    """

    sigma: float
    pixels: float
    basins: tuple[Basin, ...]


def supports(problems: Sequence[Problem]) -> Iterator[Support]:
    """The inner scales of the paper, and none at all."""
    for sigma in (0.0, *SIGMAS):
        basins = []
        for problem in problems:
            comparison = sigma_method(sigma).against(problem.reference())
            found = landscape(problem.movers, comparison, problem.target[0], problem.spacing)
            basins.append(Basin.of(problem, f"sigma {sigma:g}", 0, found.descents))
        change = np.abs(blurred(problems[0], sigma)[1])
        yield Support(sigma, float(np.mean(change >= SUPPORTED * change.max())), tuple(basins))


def blurred(problem: Problem, sigma: float) -> tuple[Host, Host, Host]:
    """The blurred signal at a problem's start, its derivative by the parameter, and the blurred reference.

    Each has shape (W,): of a picture, the middle row. The derivative is a central difference.
    """
    step = 1e-4
    places = np.array([problem.start, [problem.start[0] + step], [problem.start[0] - step]])
    images = problem.movers.images(places)
    height, width = images.shape[1:]
    blur = gaussian_blur(height, width, sigma, "reflect", like=images)
    start, ahead, behind = blur.apply(images)[:, height // 2]
    wanted = blur.apply(problem.reference()[None])[0, height // 2]
    return start, (ahead - behind) / (2.0 * step), wanted

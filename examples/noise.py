"""Measure the effect of noise on gradients and fits of a displaced disk, for docs/results/noise.md.

``python -m examples.noise`` prints the tables and writes the plot; ``--quick`` measures a few cases of each.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from examples.plots import new_figure
from loi_core import Free, GaussianPyramid, LOIObjective, Parameters, PixelL2, Pullback, ScaleSpace, fit
from loi_core.objectives import ImageObjective
from loi_core.renderers import Disks

Host = np.ndarray[Any, Any]

PLOT: Final = Path(__file__).parents[1] / "docs" / "results" / "images" / "noise.png"
SIZE: Final = 48  # pixels a side
RADIUS: Final = 4.0
BACKGROUND, DISK = 0.25, 0.75
MARGIN: Final = 8.0  # pixels that centres keep from the frame
DISTANCES: Final = (3.0, 24.0)  # pixels between the centres: disks that overlap, and disks far apart
STRENGTHS: Final = (0.05, 0.1, 0.2, 0.4)  # standard deviations, where the disk and the background differ by 0.5
REFERENCE_SEED_OFFSET: Final = 2**20  # references and renders have different noise
TOLERANCE_PX: Final = 1.0  # from the true centre
OBJECTIVES: Final[dict[str, Callable[[Host], ImageObjective[Any]]]] = {
    "pixel L2": PixelL2,
    "Gaussian pyramid": GaussianPyramid,
    "sigma only": lambda reference: LOIObjective(reference, ScaleSpace((1, 5, 15, 45), 0, 0.125)),
    "loi, vector": lambda reference: LOIObjective(reference, ScaleSpace.paper("vector")),
    "loi, path": lambda reference: LOIObjective(reference, ScaleSpace.paper("path")),
    "loi, raster": lambda reference: LOIObjective(reference, ScaleSpace.paper("raster")),
    "loi, for_image": LOIObjective,
}


class NoisyDisk:
    """A grey disk with noise that depends on the seed alone, as with few samples per pixel."""

    def __init__(self, centre: Host, strength: float) -> None:
        self._disk = Disks(SIZE, SIZE, centre[None], RADIUS, [[DISK] * 3], [BACKGROUND] * 3)
        self._strength = strength

    def parameters(self) -> Parameters:
        """Return the parameters of :class:`Disks`."""
        return dict(self._disk.parameters())

    def render(self, params: Parameters, *, seed: int = 0) -> Host:
        """Return the image, shape (SIZE, SIZE, 1)."""
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Host, Pullback]:
        """Return the image and its pullback; the noise does not depend on the parameters."""
        image, pullback = self._disk.render_vjp(params)
        unused = np.zeros((SIZE, SIZE, 2))

        def grey_pullback(cotangent: Host) -> Parameters:
            return dict(pullback(np.concatenate([cotangent, unused], axis=-1)))

        return image[..., :1] + noise(self._strength, seed), grey_pullback


def noise(strength: float, seed: int) -> Host:
    """Return independent Gaussian noise for every value of an image."""
    return strength * np.random.default_rng([seed, 1]).standard_normal((SIZE, SIZE, 1))


def picture(centre: Host, strength: float = 0.0, seed: int = 0) -> Host:
    """Return the noisy disk at a centre."""
    disk = NoisyDisk(centre, strength)
    return disk.render(disk.parameters(), seed=seed)


@dataclass(frozen=True)
class Slope:
    """Effect of noise on the gradient with respect to the disk's centre.

    Attributes
    ----------
    objective : str
    distance, strength : float
    in_reference : bool
        Whether the reference has independent noise of the same strength.
    cosine : float
        Mean cosine of the gradients with and without noise; NaN if the latter is 0.
    bias : float
        Relative error of the mean gradient over seeds.
    towards : float
        Fraction of seeds with a descent direction towards the goal.
    """

    objective: str
    distance: float
    strength: float
    in_reference: bool
    cosine: float
    bias: float
    towards: float


def slope(name: str, distance: float, strength: float, seeds: int, *, in_reference: bool) -> Slope:
    """Measure one case; every seed has its own goal and start at this distance."""
    clean, noisy, aims = (np.zeros((seeds, 2)) for _ in range(3))
    for seed in range(seeds):
        start, goal = start_and_goal(distance, seed)
        for gradients, level in ((clean, 0.0), (noisy, strength)):
            objective = OBJECTIVES[name](
                picture(goal, level if in_reference else 0.0, seed=REFERENCE_SEED_OFFSET + seed)
            )
            disk = NoisyDisk(start, level)
            image, pullback = disk.render_vjp(disk.parameters(), seed=seed)
            gradients[seed] = pullback(objective.value_and_grad(image)[1])["positions"][0]
        aims[seed] = goal - start
    towards = float(np.mean(np.sum(noisy * aims, axis=1) < 0.0))
    sizes = np.linalg.norm(clean, axis=1)
    if not sizes.all():
        return Slope(name, distance, strength, in_reference, np.nan, np.nan, towards)
    cosines = np.sum(clean * noisy, axis=1) / (sizes * np.linalg.norm(noisy, axis=1))
    # Each seed has its own direction, so errors are averaged in the frame of the noise-free gradient.
    parallel = np.sum((noisy - clean) * clean, axis=1) / sizes**2
    orthogonal = (noisy[:, 0] * clean[:, 1] - noisy[:, 1] * clean[:, 0]) / sizes**2
    bias = float(np.hypot(np.mean(parallel), np.mean(orthogonal)))
    return Slope(name, distance, strength, in_reference, float(np.mean(cosines)), bias, towards)


def start_and_goal(distance: float, seed: int) -> tuple[Host, Host]:
    """Return start and goal at this distance, both well inside the frame."""
    rng = np.random.default_rng([seed, 2])
    while True:
        start = rng.uniform(MARGIN, SIZE - MARGIN, 2)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        goal = start + distance * np.array([np.cos(angle), np.sin(angle)])
        if np.all((goal >= MARGIN) & (goal <= SIZE - MARGIN)):
            return start, goal


def recovered(name: str, strength: float, seeds: int, steps: int, *, in_render: bool) -> float:
    """Return the fraction of distant fits that end at the goal of a noisy reference, also with noisy renders."""
    solved = 0
    for seed in range(seeds):
        start, goal = start_and_goal(DISTANCES[-1], seed)
        renderer = NoisyDisk(start, strength if in_render else 0.0)
        objective = OBJECTIVES[name](picture(goal, strength, seed=REFERENCE_SEED_OFFSET + seed))
        frame = {"positions": Free(lower=RADIUS, upper=SIZE - RADIUS)}
        result = fit(renderer, objective, steps=steps, learning_rate=2.0, optimise=frame, seed=1000 * seed)
        solved += float(np.linalg.norm(result.params["positions"][0] - goal)) < TOLERANCE_PX
    return solved / seeds


def print_slopes(slopes: Sequence[Slope]) -> None:
    """Print a table for each distance: cosine, bias and fraction with the correct sign."""
    strengths = list(dict.fromkeys(case.strength for case in slopes))
    for (distance, in_reference), group in itertools.groupby(slopes, lambda case: (case.distance, case.in_reference)):
        noisy_images = "render and reference" if in_reference else "the render"
        print(f"\n{distance:g} pixels apart, noise in {noisy_images}: cosine, bias, share towards the goal\n")
        print("| noise | " + " | ".join(f"{strength:g}" for strength in strengths) + " |")
        print("| --- |" + " --- |" * len(strengths))
        for name, row in itertools.groupby(group, lambda case: case.objective):
            print(f"| {name} | " + " | ".join(map(_cell, row)) + " |")


def _cell(case: Slope) -> str:
    quality = "no gradient without noise" if np.isnan(case.cosine) else f"{case.cosine:.2f}, {case.bias:.2f}"
    return f"{quality}, {case.towards:.0%}"


def print_recoveries(shares: dict[str, list[tuple[float, float]]], strengths: Sequence[float]) -> None:
    """Print the fits with noise in the reference alone, and in both images."""
    print("\nFits that end within a pixel of the goal: noise in the reference, noise in reference and render\n")
    print("| noise | " + " | ".join(f"{strength:g}" for strength in strengths) + " |")
    print("| --- |" + " --- |" * len(strengths))
    for name, row in shares.items():
        print(f"| {name} | " + " | ".join(f"{clean:.0%}, {noisy:.0%}" for clean, noisy in row) + " |")


def plot(
    slopes: Sequence[Slope], shares: dict[str, list[tuple[float, float]]], strengths: Sequence[float], path: Path
) -> None:
    """Plot a noisy reference, the cosines of distant disks, and the solved fits."""
    figure = new_figure(11.0, 3.6)
    axes = figure.subplots(1, 3, width_ratios=[0.8, 1.0, 1.0])
    start, goal = start_and_goal(DISTANCES[-1], 0)
    axes[0].imshow(picture(goal, strengths[-1])[..., 0], cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
    axes[0].plot(*(start - 0.5), "+", color="#c2410c", markersize=12, markeredgewidth=2)
    axes[0].set(xticks=[], yticks=[], title=f"reference, noise {strengths[-1]:g}; a fit starts at the cross")
    axes[0].title.set_fontsize(8)
    for number, name in enumerate(OBJECTIVES):
        width = 1.0 + 0.7 * (len(OBJECTIVES) - number)  # where lines lie on each other, the lower ones show as rims
        distant = [
            case
            for case in slopes
            if case.objective == name and case.distance == DISTANCES[-1] and not case.in_reference
        ]
        style = "--" if name in ("pixel L2", "Gaussian pyramid", "sigma only") else "-"
        (line,) = axes[1].plot(
            [case.strength for case in distant], [case.cosine for case in distant], style, marker="o", label=name
        )
        markers = {"marker": "o", "markersize": 3.0 + width, "linewidth": width, "color": line.get_color()}
        axes[2].plot(strengths, [clean_render for clean_render, _ in shares[name]], style, **markers)
    axes[1].set(
        xlabel="noise in the render", title=f"cosine with the gradient without noise, {DISTANCES[-1]:g} pixels apart"
    )
    axes[2].set(xlabel="noise in the reference", title="fraction of solved fits", ylim=(-0.05, 1.05))
    for axis in axes[1:]:
        axis.title.set_fontsize(9)
    axes[1].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables and write the plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few seeds, steps and noises, for a test")
    parser.add_argument("--output", type=Path, default=PLOT, help="where to write the plot")
    options = parser.parse_args(arguments)
    strengths = (0.1, 0.4) if options.quick else STRENGTHS
    distances = DISTANCES[-1:] if options.quick else DISTANCES
    seeds, fits, steps = (4, 1, 30) if options.quick else (32, 8, 80)
    slopes = [
        slope(name, distance, strength, seeds, in_reference=in_reference)
        for distance in distances
        for in_reference in (False, True)
        for name in OBJECTIVES
        for strength in strengths
    ]
    print_slopes(slopes)
    shares = {
        name: [
            (
                recovered(name, strength, fits, steps, in_render=False),
                recovered(name, strength, fits, steps, in_render=True),
            )
            for strength in (0.0, *strengths)
        ]
        for name in OBJECTIVES
    }
    print_recoveries(shares, (0.0, *strengths))
    plot(slopes, shares, (0.0, *strengths), options.output)


if __name__ == "__main__":
    main()

"""Draw the one-dimensional figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from examples.paper.figures.landscapes import NEAR_DISTANCE_PX, Landscape
from examples.paper.figures.measure1d import blurred
from examples.paper.figures.signals import Host
from examples.paper.lib.methods import METHODS, SIGMAS, sigma_method
from examples.paper.lib.problems import Problem
from examples.plots import new_figure
from loi_core import ScaleSpace, local_histograms

__all__ = ["draw_landscapes", "draw_support", "draw_two"]

REFERENCE, START, CHANGE, ERROR, LOI = "#334155", "#c2410c", "#ea9a3e", "#3f9b32", "#c2410c"
ERROR_SAMPLES: Final = 120  # of a plotted curve
DOTS_PER_INCH: Final = 72


def draw_support(problem: Problem, path: Path) -> None:
    """Draw signals, derivatives and errors at growing inner scales."""
    sigmas = (0.0, *SIGMAS[1:])
    figure = new_figure(2.9 * len(sigmas), 6.0)
    rows = figure.subplots(3, len(sigmas), squeeze=False)
    for sigma, signals, gradients, errors in zip(sigmas, *rows, strict=True):
        signal, change, target = blurred(problem, sigma)
        signals.plot(signal, color=START, label="start")
        signals.plot(target, ":", color=REFERENCE, label="target")
        signals.set(title=f"sigma = {sigma:g}", ylim=(-0.05, 1.15))
        gradients.plot(change / np.abs(change).max(), color=CHANGE, label="dI/dtheta")
        product = 2.0 * (signal - target) * change
        gradients.plot(product / max(np.abs(product).max(), 1e-30), color=ERROR, label="dE/dI dI/dtheta")
        comparison = sigma_method(sigma).against(problem.reference())
        _error(errors, problem, comparison.values)
        errors.axvline(problem.start[0], color=START, linewidth=0.8)
        errors.set(xlabel="theta, pixels")
    for axes, name in zip(rows[:, 0], ("signal", "derivatives, scaled", "error"), strict=True):
        axes.set_ylabel(name)
    rows[0, 0].legend(fontsize=7)
    rows[1, 0].legend(fontsize=7)
    _save(figure, path)


def draw_landscapes(problem: Problem, landscapes: Mapping[str, Landscape], distance: float, path: Path) -> None:
    """Draw signals and local histograms, then the error and the slope of every method with its basin shaded.

    A descent belongs to the basin if it ends within `distance` pixels of the target.
    """
    figure = new_figure(1.6 * len(METHODS), 5.6)
    signal_figure, method_figure = figure.subfigures(2, 1, height_ratios=[1.0, 1.9], squeeze=False)[:, 0]
    _signals(signal_figure.subplots(1, 3), problem)
    rows = method_figure.subplots(2, len(METHODS), squeeze=False)
    for method, errors, slopes in zip(METHODS, *rows, strict=True):
        landscape = landscapes[method.name]
        _error(errors, problem, method.against(problem.reference()).values)
        errors.set_title(method.name, fontsize=9, color=LOI if method.name.startswith("loi") else "black")
        slopes.plot(landscape.positions, landscape.slopes / np.abs(landscape.slopes).max(), color=ERROR, linewidth=0.7)
        slopes.axhline(0.0, color="black", linewidth=0.4)
        slopes.set(xlabel="theta, pixels", ylim=(-1.1, 1.1))
        left, right = landscape.descents.basin(distance)
        for axes in (errors, slopes):
            if left < right:
                span = landscape.target + left, landscape.target + right
                axes.axvspan(*span, color="#16a34a", alpha=0.15, linewidth=0)
            axes.axvline(landscape.target, color=REFERENCE, linestyle=":", linewidth=0.8)
    rows[0, 0].set_ylabel("error")
    rows[1, 0].set_ylabel("slope, scaled")
    _save(figure, path)


def draw_two(problem: Problem, descents: Mapping[str, tuple[Host, Host]], path: Path) -> None:
    """Draw descents from their starts to their endpoints in the plane of two parameters."""
    figure = new_figure(1.6 * len(descents), 2.1)
    for axes, (name, (starts, endpoints)) in zip(figure.subplots(1, len(descents)), descents.items(), strict=True):
        is_near = np.all(np.abs(endpoints - problem.target) <= NEAR_DISTANCE_PX, axis=1)
        for start, endpoint, succeeds in zip(starts, endpoints, is_near, strict=True):
            axes.plot(*zip(start, endpoint, strict=True), color="#16a34a" if succeeds else "#cbd5e1", linewidth=0.7)
        axes.plot(*starts.T, ".", color="#64748b", markersize=3)
        axes.plot(*problem.target, "+", color=START, markersize=10)
        axes.set_title(name, fontsize=9, color=LOI if name.startswith("loi") else "black")
        axes.set(xlabel="bright interval", xticks=[], yticks=[])
    figure.axes[0].set_ylabel("dim interval")
    _save(figure, path)


def _signals(axes: Sequence[Axes], problem: Problem) -> None:
    """Draw start and reference, the reference as an image, and its local histograms along the axis."""
    reference = problem.reference()
    start = problem.objects.images(np.array([problem.start]))[0]
    middle = reference.shape[0] // 2
    axes[0].plot(reference[middle], color=REFERENCE, linewidth=0.9, label="reference")
    axes[0].plot(start[middle], ":", color=START, label="start")
    axes[0].legend(fontsize=7)
    axes[0].set_title("signals" if len(reference) == 1 else "middle rows", fontsize=9)
    axes[1].imshow(reference, cmap="gray", vmin=0.0, vmax=1.0, aspect="auto" if len(reference) == 1 else "equal")
    axes[1].set_title("reference", fontsize=9)
    axes[1].set(xticks=[], yticks=[])
    width = reference.shape[1]
    scales = ScaleSpace.for_image(width, width)
    beta, alpha = scales.beta[0], scales.alpha[0]
    histograms = local_histograms(reference[..., None], scales, sigma=1.0, beta=beta, alpha=alpha)[:, middle, :, 0]
    levels = scales.levels(beta)
    extent = (0.0, float(width), float(levels[0]), float(levels[-1]))
    axes[2].imshow(histograms, origin="lower", aspect="auto", cmap="magma", extent=extent)
    axes[2].set(ylim=(-0.2, 1.2))
    axes[2].set_title(f"local histograms, alpha = {alpha:g}", fontsize=9)


def _error(axes: Axes, problem: Problem, values: Any) -> None:
    lower, upper = (float(bound[0]) for bound in problem.objects.bounds)
    positions = np.linspace(lower, upper, ERROR_SAMPLES)
    axes.plot(positions, values(problem.objects.images(positions[:, None])), color=REFERENCE, linewidth=0.9)
    axes.set(yticks=[])


def _save(figure: Figure, path: Path) -> None:
    for axes in figure.axes:
        axes.tick_params(labelsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DOTS_PER_INCH)

"""Tests of the one-dimensional figures: exact signals, the ends of descents, and reproducible numbers."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from examples.paper.figures.landscapes import REACHED_DISTANCE_PX, Landscape, descend, landscape
from examples.paper.figures.measure1d import Basin
from examples.paper.figures.signals import Line, MovingObjects
from examples.paper.lib.methods import METHODS, SIGMAS, SigmaSpace
from examples.paper.lib.problems import PROBLEMS, SUPPORT, TONAL, TWO
from loi_core.testing import check_objective
from tests.strategies import thorough

ROOT = Path(__file__).parents[2]
BY_NAME = {method.name: method for method in METHODS}


@given(left=st.floats(4.0, 9.0), gap=st.floats(8.0, 12.0), radii=st.tuples(st.floats(0.2, 4.0), st.floats(0.2, 4.0)))
def test_intervals_cover_their_exact_area(left: float, gap: float, radii: tuple[float, float]) -> None:
    line = Line(26, radii, (0.7, 0.2), (0.0, 0.0), (0, 1))
    signal = line.images(np.array([[left, left + gap]]))[0, 0]
    assert signal.sum() == pytest.approx(2.0 * (0.7 * radii[0] + 0.2 * radii[1]), rel=1e-12)


@pytest.mark.parametrize("objects", [TONAL[0].objects, TONAL[3].objects, TWO.objects, SUPPORT[1].objects])
def test_the_vjp_of_moving_objects_equals_central_differences_of_their_images(objects: MovingObjects) -> None:
    rng = np.random.default_rng(0)
    lower, upper = objects.bounds
    positions = rng.uniform(lower + 0.1, upper - 0.1, (6, len(lower)))
    weights = np.asarray(rng.standard_normal(objects.images(positions).shape))
    step = 1e-6  # images are linear between the borders of pixels, which so short a step crosses with odds of 1e-5
    for index, unit in enumerate(np.eye(len(lower))):
        derivative = (objects.images(positions + step * unit) - objects.images(positions - step * unit)) / (2.0 * step)
        expected = np.sum(derivative * weights, axis=(1, 2))
        assert objects.vjp(positions, weights)[:, index] == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_objects_touch_the_frame_at_the_bounds() -> None:
    for problem in (*PROBLEMS, TWO):
        lower, upper = problem.objects.bounds
        for position in (lower, upper):
            image = problem.objects.images(position[None])[0]
            centred = problem.objects.images(0.5 * (lower + upper)[None])[0]
            assert np.all((lower <= problem.target) & (problem.target <= upper))
            if None not in problem.objects.parameter_indices and problem is not TWO:  # no object can hide another
                background = problem.objects.background
                assert np.sum(image - background) == pytest.approx(np.sum(centred - background), rel=1e-9)


def test_matching_in_the_inner_scale_space_equals_scipy_and_is_an_objective() -> None:
    image, reference = np.random.default_rng(1).uniform(size=(2, 1, 40, 1))
    blurred = [
        [gaussian_filter1d(signal[0, :, 0], sigma, mode="reflect", truncate=9.0) for signal in (image, reference)]
        for sigma in SIGMAS
    ]
    expected = sum(float(np.mean((first - second) ** 2)) for first, second in blurred)
    assert float(SigmaSpace(reference).value(image)) == pytest.approx(expected, rel=1e-9)
    check_objective(SigmaSpace)


@pytest.mark.parametrize("name", ["pixel L2", "sigma only", "loi, paper", "loi, for_image"])
def test_one_row_and_many_equal_rows_have_equal_objectives(name: str) -> None:
    # Some methods need several rows; equal rows let all methods compare the same signal.
    problem = SUPPORT[0]
    images = problem.objects.images(np.array([[20.3], [60.8]]))
    method = BY_NAME[name]
    single, tall = (method.against(np.repeat(problem.reference(), rows, axis=0)) for rows in (1, 12))
    assert tall.values(np.repeat(images, 12, axis=1)) == pytest.approx(single.values(images), rel=1e-9)
    summed = tall.gradients(np.repeat(images, 12, axis=1)).sum(axis=1)
    expected = single.gradients(images)[:, 0]
    # Where a difference is 0 up to rounding, rounding may choose the sign of its absolute value's derivative.
    assert np.linalg.norm(summed - expected) <= 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_gradients_of_a_batch_equal_gradients_of_single_images(method: Any) -> None:
    problem = SUPPORT[0]
    images = problem.objects.images(np.array([[40.2], [60.1], [75.9]]))
    comparison = method.against(problem.reference())
    for image, gradient in zip(images, comparison.gradients(images), strict=True):
        expected = comparison.gradients(image[None])[0]
        assert np.linalg.norm(expected - gradient) <= 1e-3 * np.linalg.norm(expected)  # LPIPS is in float32


def made_landscape(slopes: Any, minima: dict[int, float], target: float = 5.0) -> Landscape:
    return Landscape(np.arange(len(slopes), dtype=np.float64) + 0.5, slopes, minima, target)


def test_descent_ends_at_minima_at_plateaus_and_at_bounds() -> None:
    slopes = np.array([1.0, 1.0, -1.0, -2.0, -1.0, 3.0, 1.0, 0.0, 0.0, -1.0, -1.0])
    descents = made_landscape(slopes, {4: 5.02}).descents
    assert descents.endpoints.tolist() == [0.5, 0.5, 5.02, 5.02, 5.02, 5.02, 5.02, 7.5, 8.5, 10.5, 10.5]
    assert descents.share(REACHED_DISTANCE_PX) == 5 / 11
    assert descents.basin(REACHED_DISTANCE_PX) == (-3.0, 2.0)
    assert descents.offset == pytest.approx(0.02)
    assert descents.basin(0.01) == (0.0, 0.0)


@given(st.lists(st.sampled_from([-2.0, -1.0, 1.0, 3.0]), min_size=2, max_size=40))
def test_descents_preserve_the_order_of_their_starts_and_go_downhill(signs: list[float]) -> None:
    slopes = np.array(signs)
    changes = np.flatnonzero((slopes[:-1] < 0) & (slopes[1:] > 0))
    descents = made_landscape(slopes, {int(index): float(index) + 1.0 for index in changes}).descents
    assert np.all(np.diff(descents.endpoints) >= 0.0)
    assert np.all((descents.endpoints - descents.starts) * -slopes >= 0.0)


def test_the_basin_of_pixels_is_as_wide_as_the_overlap() -> None:
    problem = SUPPORT[0]
    descents = landscape(problem.objects, BY_NAME["pixel L2"].against(problem.reference()), 67.3, 0.1).descents
    left, right = descents.basin(REACHED_DISTANCE_PX)
    overlap = 2.0 * problem.objects.radii[0]
    assert -left == pytest.approx(overlap, abs=1.0)  # an edge covers its pixel in part
    assert right == pytest.approx(overlap, abs=1.0)
    assert abs(descents.offset) < 0.01


def test_gradient_descent_ends_at_the_minima_of_the_landscape() -> None:
    problem = SUPPORT[0]
    comparison = BY_NAME["pixel L2"].against(problem.reference())
    starts = np.array([[57.3], [62.8], [70.3], [77.8]])
    endpoints = descend(problem.objects, comparison, starts, 200)
    assert np.all(np.abs(endpoints - 67.3) <= REACHED_DISTANCE_PX)
    outside = descend(problem.objects, comparison, np.array([[30.3]]), 200)
    assert abs(float(outside[0, 0]) - 67.3) > 20.0


def test_quick_figures_are_drawn_and_agree_with_the_paper(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "examples.paper", "figures1d", "--quick", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    for name in ("one-signal", "support", "two"):
        assert (tmp_path / "images" / "figures-1d" / f"{name}.png").stat().st_size > 5_000
    with (tmp_path / "figures-1d.csv").open() as stream:
        rows = {(row["problem"], row["method"]): float(row["near"]) for row in csv.DictReader(stream)}
    # At a large distance, past a neighbour of another intensity, or in noise, only all three scales reach the target.
    for problem in ("signal", "three intensities in a row", "signal, noise 0.1"):
        assert rows[problem, "loi, for_image"] == 1.0
        assert all(rows[problem, name] < 0.6 for name in ("pixel L2", "Gaussian pyramid", "MS-SSIM", "sigma only"))
    # For one object the basin widens with the inner scale.
    widths = [rows["signal", f"sigma {sigma:g}"] for sigma in (0, 1, 5, 15, 45)]
    assert widths == sorted(widths)
    assert widths[-1] == 1.0
    page = (tmp_path / "figures-1d.md").read_text()
    assert done.stdout.strip().splitlines()[-1] in page


@pytest.mark.parametrize(
    "problem",
    [SUPPORT[0], TONAL[0], *(pytest.param(problem, marks=thorough) for problem in TONAL[1:])],
    ids=lambda problem: problem.name,
)
@pytest.mark.parametrize("name", ["pixel L2", "sigma only", "loi, for_image"])
def test_the_documented_basins_are_reproducible(problem: Any, name: str) -> None:
    with (ROOT / "docs" / "results" / "figures-1d.csv").open() as stream:
        rows = {(row["problem"], row["method"]): row for row in csv.DictReader(stream)}
    row = rows[problem.name, name]
    comparison = BY_NAME[name].against(problem.reference())
    descents = landscape(problem.objects, comparison, problem.target[0], problem.spacing).descents
    basin = Basin.of(problem, name, 0, descents)
    assert basin.found == pytest.approx(float(row["found"]), abs=0.01)
    documented = (ROOT / "docs" / "results" / "figures-1d.md").read_text()
    assert f"{float(row['left']):.1f} + {float(row['right']):.1f}, {float(row['found']):.0%}" in documented


def test_the_error_for_an_unknown_experiment_lists_all_experiments() -> None:
    command = [sys.executable, "-m", "examples.paper", "table9"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    assert "figures1d" in done.stderr
    assert "table1" in done.stderr

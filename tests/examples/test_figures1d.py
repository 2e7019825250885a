"""The one-dimensional figures: exact signals, descents that end where they must, and numbers that can be had again."""

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
BY_NAME = {one.name: one for one in METHODS}


@given(left=st.floats(4.0, 9.0), gap=st.floats(8.0, 12.0), radii=st.tuples(st.floats(0.2, 4.0), st.floats(0.2, 4.0)))
def test_intervals_cover_their_exact_area(left: float, gap: float, radii: tuple[float, float]) -> None:
    line = Line(26, radii, (0.7, 0.2), (0.0, 0.0), (0, 1))
    signal = line.images(np.array([[left, left + gap]]))[0, 0]
    assert signal.sum() == pytest.approx(2.0 * (0.7 * radii[0] + 0.2 * radii[1]), rel=1e-12)


@pytest.mark.parametrize("objects", [TONAL[0].objects, TONAL[3].objects, TWO.objects, SUPPORT[1].objects])
def test_slopes_are_the_derivatives_of_the_images(objects: MovingObjects) -> None:
    rng = np.random.default_rng(0)
    low, high = objects.bounds
    places = rng.uniform(low + 0.1, high - 0.1, (6, len(low)))
    weights = np.asarray(rng.standard_normal(objects.images(places).shape))
    step = 1e-6  # images are linear between the borders of pixels, which so short a step meets with odds of 1e-5
    for number, unit in enumerate(np.eye(len(low))):
        change = (objects.images(places + step * unit) - objects.images(places - step * unit)) / (2.0 * step)
        wanted = np.sum(change * weights, axis=(1, 2))
        assert objects.vjp(places, weights)[:, number] == pytest.approx(wanted, rel=1e-4, abs=1e-5)


def test_objects_touch_the_frame_at_the_bounds() -> None:
    for problem in (*PROBLEMS, TWO):
        low, high = problem.objects.bounds
        for place in (low, high):
            image = problem.objects.images(place[None])[0]
            whole = problem.objects.images(0.5 * (low + high)[None])[0]
            assert np.all((low <= problem.target) & (problem.target <= high))
            if None not in problem.objects.parameter_indices and problem is not TWO:  # no object can hide another
                background = problem.objects.background
                assert np.sum(image - background) == pytest.approx(np.sum(whole - background), rel=1e-9)


def test_matching_in_the_inner_scale_space_is_what_scipy_computes_and_an_objective() -> None:
    image, reference = np.random.default_rng(1).uniform(size=(2, 1, 40, 1))
    blurred = [
        [gaussian_filter1d(one[0, :, 0], sigma, mode="reflect", truncate=9.0) for one in (image, reference)]
        for sigma in SIGMAS
    ]
    wanted = sum(float(np.mean((one - other) ** 2)) for one, other in blurred)
    assert float(SigmaSpace(reference).value(image)) == pytest.approx(wanted, rel=1e-9)
    check_objective(SigmaSpace)


@pytest.mark.parametrize("name", ["pixel L2", "sigma only", "loi, paper", "loi, for_image"])
def test_one_row_and_many_equal_rows_are_one_signal(name: str) -> None:
    # So methods that cannot do with one row are compared with the others on the same problem.
    problem = SUPPORT[0]
    images = problem.objects.images(np.array([[20.3], [60.8]]))
    method = BY_NAME[name]
    single, tall = (method.against(np.repeat(problem.reference(), rows, axis=0)) for rows in (1, 12))
    assert tall.values(np.repeat(images, 12, axis=1)) == pytest.approx(single.values(images), rel=1e-9)
    spread = tall.gradients(np.repeat(images, 12, axis=1)).sum(axis=1)
    wanted = single.gradients(images)[:, 0]
    # Where the loss is |difference| of what only rounding tells from 0, rounding may choose the sign.
    assert np.linalg.norm(spread - wanted) <= 1e-6 * np.linalg.norm(wanted)


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_gradients_are_those_of_each_image_alone(method: Any) -> None:
    problem = SUPPORT[0]
    images = problem.objects.images(np.array([[40.2], [60.1], [75.9]]))
    comparison = method.against(problem.reference())
    together = comparison.gradients(images)
    for image, gradient in zip(images, together, strict=True):
        alone = comparison.gradients(image[None])[0]
        assert np.linalg.norm(alone - gradient) <= 1e-3 * np.linalg.norm(alone)  # LPIPS is in float32


def made_landscape(slopes: Any, minima: dict[int, float], target: float = 5.0) -> Landscape:
    return Landscape(np.arange(len(slopes), dtype=np.float64) + 0.5, slopes, minima, target)


def test_descent_ends_at_minima_at_plateaus_and_at_bounds() -> None:
    slopes = np.array([1.0, 1.0, -1.0, -2.0, -1.0, 3.0, 1.0, 0.0, 0.0, -1.0, -1.0])
    found = made_landscape(slopes, {4: 5.02}).descents
    assert found.endpoints.tolist() == [0.5, 0.5, 5.02, 5.02, 5.02, 5.02, 5.02, 7.5, 8.5, 10.5, 10.5]
    assert found.share(REACHED_DISTANCE_PX) == 5 / 11
    assert found.basin(REACHED_DISTANCE_PX) == (-3.0, 2.0)
    assert found.offset == pytest.approx(0.02)
    assert found.basin(0.01) == (0.0, 0.0)


@given(st.lists(st.sampled_from([-2.0, -1.0, 1.0, 3.0]), min_size=2, max_size=40))
def test_what_starts_between_two_starts_ends_between_their_ends(signs: list[float]) -> None:
    slopes = np.array(signs)
    changes = np.flatnonzero((slopes[:-1] < 0) & (slopes[1:] > 0))
    found = made_landscape(slopes, {int(index): float(index) + 1.0 for index in changes}).descents
    assert np.all(np.diff(found.endpoints) >= 0.0)
    assert np.all((found.endpoints - found.starts) * -slopes >= 0.0)


def test_the_basin_of_pixels_is_as_wide_as_the_overlap() -> None:
    problem = SUPPORT[0]
    found = landscape(problem.objects, BY_NAME["pixel L2"].against(problem.reference()), 67.3, 0.1).descents
    left, right = found.basin(REACHED_DISTANCE_PX)
    overlap = 2.0 * problem.objects.radii[0]
    assert -left == pytest.approx(overlap, abs=1.0)  # to a pixel, which an edge covers in part
    assert right == pytest.approx(overlap, abs=1.0)
    assert abs(found.offset) < 0.01


def test_small_steps_end_where_the_landscape_says() -> None:
    problem = SUPPORT[0]
    comparison = BY_NAME["pixel L2"].against(problem.reference())
    starts = np.array([[57.3], [62.8], [70.3], [77.8]])
    ends = descend(problem.objects, comparison, starts, 200)
    assert np.all(np.abs(ends - 67.3) <= REACHED_DISTANCE_PX)
    beyond = descend(problem.objects, comparison, np.array([[30.3]]), 200)
    assert abs(float(beyond[0, 0]) - 67.3) > 20.0


def test_quick_figures_are_drawn_and_show_what_the_paper_says(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "examples.paper", "figures1d", "--quick", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    for name in ("one-signal", "support", "two"):
        assert (tmp_path / "images" / "figures-1d" / f"{name}.png").stat().st_size > 5_000
    with (tmp_path / "figures-1d.csv").open() as stream:
        rows = {(row["problem"], row["method"]): float(row["near"]) for row in csv.DictReader(stream)}
    # Far apart, or with a neighbour of another intensity in between, or in noise: only the three scales reach.
    for problem in ("signal", "three intensities in a row", "signal, noise 0.1"):
        assert rows[problem, "loi, for_image"] == 1.0
        assert all(rows[problem, name] < 0.6 for name in ("pixel L2", "Gaussian pyramid", "MS-SSIM", "sigma only"))
    # The wider the inner scale, the wider the basin, for one object.
    widths = [rows["signal", f"sigma {sigma:g}"] for sigma in (0, 1, 5, 15, 45)]
    assert widths == sorted(widths)
    assert widths[-1] == 1.0
    page = (tmp_path / "figures-1d.md").read_text()
    assert done.stdout.strip().splitlines()[-1] in page


@pytest.mark.parametrize(
    "problem",
    [SUPPORT[0], TONAL[0], *(pytest.param(one, marks=thorough) for one in TONAL[1:])],
    ids=lambda one: one.name,
)
@pytest.mark.parametrize("name", ["pixel L2", "sigma only", "loi, for_image"])
def test_the_numbers_in_the_documentation_can_be_had_again(problem: Any, name: str) -> None:
    with (ROOT / "docs" / "results" / "figures-1d.csv").open() as stream:
        (row,) = [one for one in csv.DictReader(stream) if (one["problem"], one["method"]) == (problem.name, name)]
    found = landscape(problem.objects, BY_NAME[name].against(problem.reference()), problem.target[0], problem.spacing)
    basin = Basin.of(problem, name, 0, found.descents)
    assert basin.found == pytest.approx(float(row["found"]), abs=0.01)
    documented = (ROOT / "docs" / "results" / "figures-1d.md").read_text()
    assert f"{float(row['left']):.1f} + {float(row['right']):.1f}, {float(row['found']):.0%}" in documented


def test_an_unknown_experiment_is_told_which_there_are() -> None:
    command = [sys.executable, "-m", "examples.paper", "table9"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    assert "figures1d" in done.stderr
    assert "table1" in done.stderr

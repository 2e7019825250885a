"""Tests of the kaleidoscope and the orb: targets, directions of gradients, and the quick tier."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.paper.variational import kaleidoscope, mug, orb, orb_scene
from examples.paper.variational.objectives import BlurredL2, objective
from examples.paper.variational.photograph import Photograph
from examples.paper.variational.problem import TRUTH_SEED, Problem, as_arrays
from examples.paper.variational.run import blurred, image_at, problem_of
from examples.paper.variational.settings import Method, Setting, Size
from examples.paper.variational.tables import merged_csv
from loi_core.errors import RendererError
from loi_core.pixels.psnr import psnr
from tests.strategies import thorough

IMAGE_SIDE, SAMPLES = 40, 4


@pytest.fixture(params=["kaleidoscope", "orb"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return problem_of(request.param, Size(IMAGE_SIDE, SAMPLES, 1))


def test_random_starts_fill_the_range_and_only_the_truth_counts_as_found(problem: Problem) -> None:
    starts = [problem.start(seed) for seed in range(200)]
    for name in problem.truth:
        values = [start[name] for start in starts]
        assert problem.lower[name] <= min(values) < problem.lower[name] + 0.1 * problem.span(name)
        assert problem.upper[name] >= max(values) > problem.upper[name] - 0.1 * problem.span(name)
    assert problem.is_found(problem.start(TRUTH_SEED))
    assert not any(problem.is_found(start) for start in starts)


def test_the_target_resembles_the_model_at_the_truth_more_than_at_random_starts(problem: Problem) -> None:
    truth_psnr = psnr(image_at(problem, problem.truth), problem.target)
    start_psnrs = [psnr(image_at(problem, problem.start(seed)), problem.target) for seed in range(3)]
    assert truth_psnr > max(start_psnrs) + 3.0


def test_the_target_of_the_orb_is_a_photograph_rather_than_a_render_of_the_model() -> None:
    problem = orb_scene.problem(IMAGE_SIDE, SAMPLES)
    np.testing.assert_allclose(255.0 * problem.target, np.rint(255.0 * problem.target), atol=1e-4)
    first, second = (
        np.mean([image_at(problem, problem.truth, seed=seed) for seed in range(start, start + 8)], 0)
        for start in (0, 8)
    )
    assert psnr(first, problem.target) < psnr(first, second) - 5.0


def test_a_photograph_is_dark_at_its_corners_blurred_and_noisy() -> None:
    light = np.full((32, 32, 3), 0.25)
    flat = Photograph(read_noise=0.0, full_well=1e12).of(light, seed=0)
    assert flat[0, 0, 0] < flat[8, 8, 0]
    noisy = [Photograph().of(light, seed=seed) for seed in (0, 1)]
    assert 0.002 < float(np.std(noisy[0] - noisy[1])) < 0.05
    light[:, 16:] = 0.75
    edge = Photograph(vignetting=0.0, read_noise=0.0, full_well=1e12).of(light, seed=0)[8, :, 0]
    assert np.unique(edge).size > 3


@pytest.mark.parametrize("method", ["sigma", "paper"])
def test_near_the_truth_the_gradient_points_towards_the_truth(method: Method) -> None:
    problem = orb_scene.problem(IMAGE_SIDE, SAMPLES)
    renderer = blurred(problem, Setting(method, 0.01, 0.05))
    compared = objective(method, problem.target)
    slopes = []
    for sign in (1.0, -1.0):
        params: dict[str, Any] = as_arrays(dict(problem.truth, x=problem.truth["x"] + 0.7 * sign * orb_scene.RADIUS))
        renders = [renderer.render_vjp(params, seed=seed) for seed in range(5)]
        slopes.append(np.mean([float(pullback(compared.value_and_grad(image)[1])["x"]) for image, pullback in renders]))
    assert slopes[0] > 0.0 > slopes[1]


def test_the_images_of_a_variational_problem_refuse_a_gradient(problem: Problem) -> None:
    with pytest.raises(RendererError, match="images only"):
        problem.images.render_vjp(problem.true_parameters())


def test_the_gradient_of_blurred_pixels_equals_central_differences() -> None:
    rng = np.random.default_rng(0)
    image, reference, direction = rng.random((3, 24, 20, 3))
    compared = BlurredL2(reference)
    _, gradient = compared.value_and_grad(image)
    step = 1e-3  # the value is quadratic, so the difference is exact up to rounding
    slope = float(compared.value(image + step * direction) - compared.value(image - step * direction)) / (2.0 * step)
    assert float(np.sum(gradient * direction)) == pytest.approx(slope, rel=1e-8)


@pytest.mark.parametrize("command", [kaleidoscope, orb])
def test_the_quick_tier_of_the_variational_method_runs_end_to_end_and_reports_again(
    command: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = command.__name__.rpartition(".")[2]
    command.main(["--quick", "--out", str(tmp_path)])
    first = capsys.readouterr()
    assert "loi, the paper's scales" in first.out
    if command is orb:
        command.main(["--quick", "--report", "--out", str(tmp_path)])
        assert capsys.readouterr().out == first.out
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"pixels", "paper"}
    for file in (f"{name}.png", f"{name}-starts.png", f"{name}.webp"):
        assert (tmp_path / file).exists()


def test_a_merged_csv_keeps_rows_of_other_runs_and_replaces_repeated_runs(tmp_path: Path) -> None:
    path = tmp_path / "orb.csv"
    header, old_row, other_row = (
        "method,rate,sigma,final,side,samples,steps,seed,found,psnr,seconds\n",
        "pixels,0.02,0.1,0.4,100,4,120,1,True,20.0,0.5\n",
        "sigma,0.02,0.1,0.4,100,4,120,1,False,18.0,0.5\n",
    )
    new_row = old_row.replace("20.0", "21.0")
    assert merged_csv(header + new_row, path) == header + new_row
    path.write_text(header + old_row + other_row, encoding="utf-8")
    assert merged_csv(header + new_row, path) == header + new_row + other_row


def test_the_variational_method_refuses_0_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        orb.main(["--steps", "0", "--out", str(tmp_path)])
    assert "must be 1 or more" in capsys.readouterr().err


@thorough
def test_gradients_from_images_at_other_angles_recover_a_hidden_handle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mug.main(["--quick", "--json", "--out", str(tmp_path)])
    outcomes = {line["method"]: line for line in map(json.loads, capsys.readouterr().out.splitlines())}
    assert outcomes["loi"]["verdict"] == "no gradient"
    assert outcomes["loi"]["end"] == outcomes["loi"]["start"]
    assert outcomes["loi + PRDPT"]["found"]
    assert (tmp_path / "mug.png").exists()

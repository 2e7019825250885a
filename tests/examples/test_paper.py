"""Tests of Table 1 of the paper and of the shared storage of runs: end to end, and without repeated runs."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from examples.paper.lib.means import Mean
from examples.paper.lib.runner import carry_out_all
from examples.paper.lib.store import is_done, keep, load, picture_path
from examples.paper.table1 import guidance
from examples.paper.table1.command import main
from examples.paper.table1.extent import SUBTABLES, Extent
from examples.paper.table1.moves import ReleasedMoves
from examples.paper.table1.objectives import Sums, objective
from examples.paper.table1.problem import COLUMNS, HARDER, RADIUS, Column, Problem
from examples.paper.table1.renderers import BothOrders, Noisy
from examples.paper.table1.run import Run, carry_out, structure
from examples.paper.table1.settings import LABELS, OURS, PROTOCOLS, Setting
from loi_core import ScaleSpace
from loi_core.io.images import read_image
from loi_core.pixels.psnr import psnr
from loi_core.renderers import Disks
from loi_core.testing import check_renderer

DOCS = Path(__file__).parents[2] / "docs" / "results"
STEPS = 4
SMALL = replace(COLUMNS[0], side=32)


def test_table_1_runs_end_to_end_and_does_not_repeat_finished_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--quick", "--out", str(tmp_path), "--processes", "1"]
    main(arguments)
    printed = capsys.readouterr().out
    assert (tmp_path / "table.md").read_text() == printed
    with (tmp_path / "runs.csv").open() as file:
        psnr_by_method = {row["method"]: float(row["psnr"]) for row in csv.DictReader(file)}
    assert psnr_by_method["loi"] > 40.0
    assert psnr_by_method["pixel_l2"] < 30.0
    assert len(list(tmp_path.glob("*.png"))) == 2  # a contact sheet and the convergence plot
    records = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/**/*.json")}
    main(arguments)
    assert capsys.readouterr().out == printed
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/**/*.json")} == records


def test_a_run_is_done_only_with_exactly_its_settings(tmp_path: Path) -> None:
    run = Run(replace(OURS["pixel_l2"], steps=STEPS), SMALL, 0)
    keep(tmp_path, run, carry_out(run))
    assert is_done(tmp_path, run)
    assert not is_done(tmp_path, Run(replace(run.setting, rate=0.5), SMALL, 0))
    assert not is_done(tmp_path, Run(run.setting, replace(SMALL, noise=0.1), 0))
    next(tmp_path.glob("**/*.json")).write_text("{ cut sho")
    assert not is_done(tmp_path, run)


def test_records_of_earlier_versions_are_read(tmp_path: Path) -> None:
    run = Run(replace(OURS["pixel_l2"], steps=STEPS), SMALL, 7)
    path = picture_path(tmp_path, run).with_suffix(".json")
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"run": repr(run), "psnr": 31.5, "seconds": 2.0}) + "\n")
    assert load(tmp_path, run) == {"run": repr(run), "psnr": 31.5, "seconds": 2.0}


def test_a_failing_run_ends_the_experiment_and_leaves_no_record(tmp_path: Path) -> None:
    runs = [Run(replace(OURS["pixel_l2"], steps=STEPS, rate=rate), SMALL, 0) for rate in (8.0, -1.0)]
    with pytest.raises(RuntimeError, match=r"rate=-1\.0.*`learning_rate` must"):
        carry_out_all(runs, carry_out, tmp_path, 1)
    assert [is_done(tmp_path, run) for run in runs] == [True, False]


def test_the_repr_of_a_setting_omits_later_fields_at_their_defaults() -> None:
    setting = Setting("ours", "pixel_l2", 8.0)
    expected = (
        "Setting(name='ours', method='pixel_l2', rate=8.0, scales=None, accuracy='balanced', steps=500, "
        "decay='cosine', kept='best', moves='ours')"
    )
    assert repr(setting) == expected  # as in records older than the later fields
    used = replace(setting, noise=0.1, before=replace(setting, levels="twice"))
    assert repr(used) == f"{expected[:-1]}, before={expected[:-1]}, levels='twice'), noise=0.1)"


def test_no_two_runs_of_table_1_share_a_file(tmp_path: Path) -> None:
    runs = Extent(SUBTABLES, tuple(LABELS)).runs
    assert len({picture_path(tmp_path, run) for run in runs}) == len(runs) > 1000


def test_a_limit_of_steps_applies_to_every_stage() -> None:
    runs = Extent(("remedies", "ablations"), ("loi",), steps=STEPS).runs
    assert max(len(run.setting.stages) for run in runs) == 3
    assert {stage.steps for run in runs for stage in run.setting.stages} == {STEPS}


@pytest.mark.parametrize("kept", ["best", "last"])
def test_a_stage_starts_from_the_resulting_iterate_of_the_preceding_stage(kept: Literal["best", "last"]) -> None:
    first = replace(OURS["loi"], steps=STEPS, kept=kept, decay="none", rate=16.0)
    second = replace(OURS["pixel_l2"], steps=2 * STEPS - 1, rate=1e-12)
    single, chained = (carry_out(Run(setting, SMALL, 0)) for setting in (first, replace(second, before=first)))
    assert np.array_equal(chained.image, single.image)
    assert chained.curve[:1] == single.curve
    assert chained.curve[1:] == (round(single.psnr, 3),) * 2  # after 5 and 10 of the 4 and 7 steps


def test_the_measured_image_has_no_noise_of_the_render() -> None:
    noisy, plain = (
        carry_out(Run(replace(OURS["pixel_l2"], steps=1, kept="last", noise=noise), SMALL, 0)) for noise in (0.1, 0.0)
    )
    assert np.array_equal(noisy.image, plain.image)  # both show the start
    assert noisy.curve == plain.curve


@pytest.mark.parametrize("options", [{"channels": "sums"}, {"levels": "twice"}], ids=str)
def test_gradients_of_composed_objectives_equal_central_differences(options: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    reference, image, direction = rng.uniform(size=(3, 12, 12, 3))
    setting = replace(OURS["loi"], scales=ScaleSpace(1.0, 3.0, 0.125), accuracy="exact", **options)
    composed = objective(setting, reference)
    value, gradient = composed.value_and_grad(image)
    assert composed.value(image) == pytest.approx(float(value), rel=1e-12)
    step = 1e-6
    upper, lower = (float(composed.value(image + sign * step * direction)) for sign in (1.0, -1.0))
    # Errors of central differences: rounding, 1e-16 over the step, and curvature, the step squared.
    assert np.sum(gradient * direction) == pytest.approx((upper - lower) / (2.0 * step), rel=1e-6)


def test_sums_of_channels_distinguish_colours_with_equal_channel_histograms() -> None:
    # Both images have as much red as green, but in one of them both are in the same pixels, which are yellow.
    red_and_green, yellow = np.zeros((2, 8, 8, 3))
    red_and_green[:4, :, 0] = red_and_green[4:, :, 1] = yellow[:4, :, 0] = yellow[:4, :, 1] = 1.0
    wide = ScaleSpace(0.0, 1000.0, 0.125)  # compares global histograms
    by_channel = objective(replace(OURS["loi"], scales=wide), red_and_green)
    assert float(by_channel.value(yellow)) == pytest.approx(0.0, abs=1e-6)
    assert float(Sums(red_and_green, wide, "exact").value(yellow)) > 0.1


def test_twice_the_levels_halve_the_distance_between_them() -> None:
    # With distant levels the histogram of a constant image changes in steps, whose positions need more levels.
    once, twice = (
        objective(replace(OURS["loi"], scales=ScaleSpace(0.0, 0.0, 0.125), levels=levels), np.full((4, 4, 1), 0.5))
        for levels in ("once", "twice")
    )
    image = np.full((4, 4, 1), 0.53)
    assert float(twice.value(image)) == pytest.approx(2.0 * float(once.value(image)), rel=1e-3)


def test_the_gradient_of_both_orders_reaches_hidden_disks_and_is_exact_without_overlap() -> None:
    positions = [[5.0, 5.0], [5.0, 5.0], [11.0, 11.0]]
    disks = Disks(16, 16, positions, [1.5, 4.0, 2.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    both_orders = BothOrders(disks)
    params = both_orders.parameters()
    cotangent = np.random.default_rng(0).standard_normal((16, 16, 3))
    (image, pullback), (exact_image, exact_pullback) = both_orders.render_vjp(params), disks.render_vjp(params)
    assert np.array_equal(image, exact_image)
    mean_gradient, exact_gradient = pullback(cotangent)["positions"], exact_pullback(cotangent)["positions"]
    assert np.array_equal(mean_gradient[2], exact_gradient[2])
    assert np.array_equal(exact_gradient[0], [0.0, 0.0])
    assert np.linalg.norm(mean_gradient[0]) > 0.1


def test_noisy_disks_pass_the_conformance_kit() -> None:
    check_renderer(Noisy(Problem.of(SMALL, 0).disks(confine=True), 0.1))


def test_a_repeated_run_has_equal_numbers(tmp_path: Path) -> None:
    run = Run(replace(OURS["loi"], steps=STEPS), replace(SMALL, noise=0.1, colours="random"), 3)
    first, second = carry_out(run), carry_out(run)
    assert np.array_equal(first.image, second.image)
    assert first.curve == second.curve
    keep(tmp_path, run, first)
    record = load(tmp_path, run)
    assert record is not None
    assert record["psnr"] == first.psnr
    assert np.abs(read_image(picture_path(tmp_path, run)) - np.clip(first.image, 0.0, 1.0)).max() <= 0.5 / 255.0 + 1e-7
    assert json.dumps(record)  # raises for numbers outside JSON


@pytest.mark.parametrize("column", [*COLUMNS, *HARDER], ids=lambda column: column.name)
def test_the_target_is_a_feasible_image_of_the_renderer(column: Column) -> None:
    problem = Problem.of(column, 0)
    # Disks of one colour are interchangeable, because no pixel has two disks whose painting order would matter.
    order = np.random.default_rng(0).permutation(problem.column.disks)
    disks = problem.disks(confine=problem.column.parted)
    params = disks.parameters() | {"positions": problem.goal[order], "colours": problem.colours[order]}
    assert np.allclose(disks.render(params), problem.target, rtol=0.0, atol=1e-5)  # positions are float32
    projected = disks.project(params)["positions"]
    assert np.allclose(projected, problem.goal[order], atol=1e-4)  # without overlap, and inside the frame


def test_released_moves_separate_overlapping_disks_and_no_others() -> None:
    problem = Problem.of(COLUMNS[2], 0)
    moves = ReleasedMoves(problem.disks(confine=False))
    start = moves.parameters()
    at_goal = start | {"positions": problem.goal.astype(np.float32)}
    assert np.array_equal(moves.project(at_goal)["positions"], at_goal["positions"])
    positions = moves.project(start)["positions"].astype(np.float64)
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=-1)[np.triu_indices(len(positions), 1)]
    assert distances.min() >= 2.0 * RADIUS - 1e-3


def test_protocols_differ_only_in_their_settings_and_name_every_method() -> None:
    assert all(set(methods) == set(LABELS) for methods in PROTOCOLS.values())
    assert all(setting.method == method for methods in PROTOCOLS.values() for method, setting in methods.items())


def test_means_have_student_confidence_intervals() -> None:
    mean = Mean.of([1.0, 2.0, 3.0, 4.0])
    assert (mean.value, mean.minimum, mean.count) == (2.5, 1.0, 4)
    # Half the width of a 95 % interval for four values is 3.182446 standard errors (tables of Student's t).
    assert mean.half_width == pytest.approx(3.182446 * np.std([1, 2, 3, 4], ddof=1) / 2.0, rel=1e-6)
    assert np.isnan(Mean.of([1.0]).half_width)


def test_structure_is_1_for_equal_images_and_less_for_others() -> None:
    target = Problem.of(COLUMNS[1], 0).target
    assert structure(target, target) == pytest.approx(1.0, abs=1e-12)
    assert structure(np.zeros_like(target), target) < 0.95
    assert psnr(target, target) == np.inf


@pytest.mark.parametrize(
    ("arguments", "option"),
    [(["--columns", "5"], "--columns"), (["--seeds", "0"], "--seeds"), (["--out", "/dev/null/x"], "--out")],
)
def test_table_1_refuses_wrong_options_before_any_run(
    arguments: list[str], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(arguments)
    assert exit_info.value.code == 2
    assert option in capsys.readouterr().err.splitlines()[-1]


def test_the_documented_means_of_table_1_equal_the_means_of_its_csv() -> None:
    page = (DOCS / "table1.md").read_text()
    with (DOCS / "table1.csv").open() as file:
        rows = list(csv.DictReader(file))
    cells: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        cells.setdefault((row["setting"], row["method"], row["column"]), []).append(float(row["psnr"]))
    table = {key: values for key, values in cells.items() if not key[0].startswith("rate ")}
    assert len(table) > 20
    assert all(f"{np.mean(values):.2f} " in page for values in table.values())
    # As the page states, the LOI objective reaches the target from every start of every column.
    minima = [min(table["ours", "loi", column.name]) for column in COLUMNS]
    assert all(len(table["ours", "loi", column.name]) == 10 for column in COLUMNS)
    assert min(minima) > 60.0


def test_the_gradient_points_a_single_disk_straight_to_its_target() -> None:
    single = replace(guidance.RANDOM, disks=1)
    assert all(guidance.cosines(OURS["loi"], single, seed).item() > 0.99 for seed in range(8))


def test_the_table_of_guidance_is_printed_and_written_to_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "table1.md"
    page.write_text("<!-- guidance -->\n<!-- end -->\nafter\n")
    guidance.main(["--quick", "--docs", str(tmp_path)])
    printed = capsys.readouterr().out
    assert printed.count("\n| ours ") == 1
    assert page.read_text() == f"<!-- guidance -->\n\n{printed}\n<!-- end -->\nafter\n"

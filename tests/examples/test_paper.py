"""The paper's experiments run end to end, and their runs are done once."""

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
FEW = 4
SMALL = replace(COLUMNS[0], side=32)


def test_table_1_runs_end_to_end_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--quick", "--out", str(tmp_path), "--processes", "1"]
    main(words)
    printed = capsys.readouterr().out
    assert (tmp_path / "table.md").read_text() == printed
    with (tmp_path / "runs.csv").open() as file:
        found = {row["method"]: float(row["psnr"]) for row in csv.DictReader(file)}
    assert found["loi"] > 40.0
    assert found["pixel_l2"] < 30.0
    assert len(list(tmp_path.glob("*.png"))) == 2  # a contact sheet and the convergence plot
    records = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/**/*.json")}
    main(words)
    assert capsys.readouterr().out == printed
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/**/*.json")} == records


def test_a_run_is_done_only_with_its_very_settings(tmp_path: Path) -> None:
    run = Run(replace(OURS["pixel_l2"], steps=FEW), SMALL, 0)
    keep(tmp_path, run, carry_out(run))
    assert is_done(tmp_path, run)
    assert not is_done(tmp_path, Run(replace(run.setting, rate=0.5), SMALL, 0))
    assert not is_done(tmp_path, Run(run.setting, replace(SMALL, noise=0.1), 0))
    next(tmp_path.glob("**/*.json")).write_text("{ cut sho")
    assert not is_done(tmp_path, run)


def test_records_are_those_that_kept_runs_have(tmp_path: Path) -> None:
    run = Run(replace(OURS["pixel_l2"], steps=FEW), SMALL, 7)
    path = picture_path(tmp_path, run).with_suffix(".json")
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"run": repr(run), "psnr": 31.5, "seconds": 2.0}) + "\n")
    assert load(tmp_path, run) == {"run": repr(run), "psnr": 31.5, "seconds": 2.0}


def test_a_run_that_fails_ends_all_and_leaves_no_record(tmp_path: Path) -> None:
    runs = [Run(replace(OURS["pixel_l2"], steps=FEW, rate=rate), SMALL, 0) for rate in (8.0, -1.0)]
    with pytest.raises(RuntimeError, match=r"rate=-1\.0.*`learning_rate` must"):
        carry_out_all(runs, carry_out, tmp_path, 1)
    assert [is_done(tmp_path, run) for run in runs] == [True, False]


def test_what_is_told_of_a_run_has_only_those_later_fields_that_are_used() -> None:
    setting = Setting("ours", "pixel_l2", 8.0)
    told = (
        "Setting(name='ours', method='pixel_l2', rate=8.0, scales=None, accuracy='balanced', steps=500, "
        "decay='cosine', kept='best', moves='ours')"
    )
    assert repr(setting) == told  # as records had it that were written before there were others
    used = replace(setting, noise=0.1, before=replace(setting, levels="twice"))
    assert repr(used) == f"{told[:-1]}, before={told[:-1]}, levels='twice'), noise=0.1)"


def test_no_two_runs_share_a_file(tmp_path: Path) -> None:
    runs = Extent(SUBTABLES, tuple(LABELS)).runs
    assert len({picture_path(tmp_path, run) for run in runs}) == len(runs) > 1000


def test_fewer_steps_are_of_every_stage() -> None:
    runs = Extent(("remedies", "ablations"), ("loi",), steps=FEW).runs
    assert max(len(run.setting.stages) for run in runs) == 3
    assert {stage.steps for run in runs for stage in run.setting.stages} == {FEW}


@pytest.mark.parametrize("kept", ["best", "last"])
def test_a_fit_starts_from_the_iterate_that_counts_of_the_fit_before_it(kept: Literal["best", "last"]) -> None:
    first = replace(OURS["loi"], steps=FEW, kept=kept, decay="none", rate=16.0)
    still = replace(OURS["pixel_l2"], steps=2 * FEW - 1, rate=1e-12)
    alone, both = (carry_out(Run(setting, SMALL, 0)) for setting in (first, replace(still, before=first)))
    assert np.array_equal(both.image, alone.image)
    assert both.curve[:1] == alone.curve
    assert both.curve[1:] == (round(alone.psnr, 3),) * 2  # after 5 and 10 of the 4 and 7 steps


def test_noise_on_the_render_is_not_in_the_image_that_counts() -> None:
    noisy, plain = (
        carry_out(Run(replace(OURS["pixel_l2"], steps=1, kept="last", noise=noise), SMALL, 0)) for noise in (0.1, 0.0)
    )
    assert np.array_equal(noisy.image, plain.image)  # of the start
    assert noisy.curve == plain.curve


@pytest.mark.parametrize("wanted", [{"channels": "sums"}, {"levels": "twice"}], ids=str)
def test_the_gradients_of_composed_objectives_are_those_of_their_values(wanted: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    reference, image, direction = rng.uniform(size=(3, 12, 12, 3))
    setting = replace(OURS["loi"], scales=ScaleSpace(1.0, 3.0, 0.125), accuracy="exact", **wanted)
    compared = objective(setting, reference)
    value, gradient = compared.value_and_grad(image)
    assert compared.value(image) == pytest.approx(float(value), rel=1e-12)
    step = 1e-6
    ahead, behind = (float(compared.value(image + sign * step * direction)) for sign in (1.0, -1.0))
    # Central differences: rounding of 1e-16 over the step, and curvature of its square.
    assert np.sum(gradient * direction) == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-6)


def test_sums_of_channels_see_what_no_channel_sees_alone() -> None:
    # Red and green are seen in equal amounts either way; together in one place they are yellow.
    apart, together = np.zeros((2, 8, 8, 3))
    apart[:4, :, 0] = apart[4:, :, 1] = together[:4, :, 0] = together[:4, :, 1] = 1.0
    wide = ScaleSpace(0.0, 1000.0, 0.125)  # nothing but the histogram of the image
    assert float(objective(replace(OURS["loi"], scales=wide), apart).value(together)) == pytest.approx(0.0, abs=1e-6)
    assert float(Sums(apart, wide, "exact").value(together)) > 0.1


def test_twice_the_levels_halve_the_distance_between_them() -> None:
    # With levels so far apart that the histogram of a constant image changes in steps, only more levels can tell where.
    once, twice = (
        objective(replace(OURS["loi"], scales=ScaleSpace(0.0, 0.0, 0.125), levels=levels), np.full((4, 4, 1), 0.5))
        for levels in ("once", "twice")
    )
    image = np.full((4, 4, 1), 0.53)
    assert float(twice.value(image)) == pytest.approx(2.0 * float(once.value(image)), rel=1e-3)


def test_the_gradient_of_both_orders_reaches_hidden_shapes_and_is_exact_without_overlap() -> None:
    places = [[5.0, 5.0], [5.0, 5.0], [11.0, 11.0]]
    disks = Disks(16, 16, places, [1.5, 4.0, 2.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    both = BothOrders(disks)
    params = both.parameters()
    cotangent = np.random.default_rng(0).standard_normal((16, 16, 3))
    (image, pullback), (seen, exact) = both.render_vjp(params), disks.render_vjp(params)
    assert np.array_equal(image, seen)
    reaching, exactly = pullback(cotangent)["positions"], exact(cotangent)["positions"]
    assert np.array_equal(reaching[2], exactly[2])
    assert np.array_equal(exactly[0], [0.0, 0.0])
    assert np.linalg.norm(reaching[0]) > 0.1


def test_noisy_disks_keep_the_contract() -> None:
    check_renderer(Noisy(Problem.of(SMALL, 0).disks(confine=True), 0.1))


def test_a_run_gives_the_same_numbers_again(tmp_path: Path) -> None:
    run = Run(replace(OURS["loi"], steps=FEW), replace(SMALL, noise=0.1, colours="random"), 3)
    first, second = carry_out(run), carry_out(run)
    assert np.array_equal(first.image, second.image)
    assert first.curve == second.curve
    keep(tmp_path, run, first)
    record = load(tmp_path, run)
    assert record is not None
    assert record["psnr"] == first.psnr
    assert np.abs(read_image(picture_path(tmp_path, run)) - np.clip(first.image, 0.0, 1.0)).max() <= 0.5 / 255.0 + 1e-7
    assert json.dumps(record)  # nothing that JSON has no number for


@pytest.mark.parametrize("column", [*COLUMNS, *HARDER], ids=lambda column: column.name)
def test_the_target_can_be_reached_exactly(column: Column) -> None:
    problem = Problem.of(column, 0)
    # Disks of one colour may change places: no pixel has two disks, else the order of painting would show.
    order = np.random.default_rng(0).permutation(problem.column.disks)
    disks = problem.disks(confine=problem.column.parted)
    params = disks.parameters() | {"positions": problem.goal[order], "colours": problem.colours[order]}
    assert np.allclose(disks.render(params), problem.target, rtol=0.0, atol=1e-5)  # single precision of places
    settled = disks.project(params)["positions"]
    assert np.allclose(settled, problem.goal[order], atol=1e-4)  # neither pushed apart nor out of the frame


def test_released_moves_part_disks_and_leave_those_alone_that_do_not_touch() -> None:
    problem = Problem.of(COLUMNS[2], 0)
    moves = ReleasedMoves(problem.disks(confine=False))
    start = moves.parameters()
    at_goal = start | {"positions": problem.goal.astype(np.float32)}
    assert np.array_equal(moves.project(at_goal)["positions"], at_goal["positions"])
    places = moves.project(start)["positions"].astype(np.float64)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(len(places), 1)]
    assert apart.min() >= 2.0 * RADIUS - 1e-3


def test_protocols_differ_only_in_their_settings_and_name_every_method() -> None:
    assert all(set(methods) == set(LABELS) for methods in PROTOCOLS.values())
    assert all(setting.method == method for methods in PROTOCOLS.values() for method, setting in methods.items())


def test_means_come_with_their_interval() -> None:
    mean = Mean.of([1.0, 2.0, 3.0, 4.0])
    assert (mean.value, mean.minimum, mean.count) == (2.5, 1.0, 4)
    # Half of an interval of 95 % for four values: 3.182446 standard errors (any table of Student's t).
    assert mean.half_width == pytest.approx(3.182446 * np.std([1, 2, 3, 4], ddof=1) / 2.0, rel=1e-6)
    assert np.isnan(Mean.of([1.0]).half_width)


def test_structure_is_1_for_equal_images_and_less_for_others() -> None:
    target = Problem.of(COLUMNS[1], 0).target
    assert structure(target, target) == pytest.approx(1.0, abs=1e-12)
    assert structure(np.zeros_like(target), target) < 0.95
    assert psnr(target, target) == np.inf


@pytest.mark.parametrize(
    ("words", "named"),
    [(["--columns", "5"], "--columns"), (["--seeds", "0"], "--seeds"), (["--out", "/dev/null/x"], "--out")],
)
def test_wrong_words_are_refused_before_anything_is_done(
    words: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert named in capsys.readouterr().err.splitlines()[-1]


def test_documented_means_are_those_of_the_documented_runs() -> None:
    page = (DOCS / "table1.md").read_text()
    with (DOCS / "table1.csv").open() as file:
        rows = list(csv.DictReader(file))
    cells: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        cells.setdefault((row["setting"], row["method"], row["column"]), []).append(float(row["psnr"]))
    table = {key: values for key, values in cells.items() if not key[0].startswith("rate ")}
    assert len(table) > 20
    assert all(f"{np.mean(values):.2f} " in page for values in table.values())
    # What the page says of ours: every start of every column ends exactly.
    ours = [min(table["ours", "loi", column.name]) for column in COLUMNS]
    assert all(len(table["ours", "loi", column.name]) == 10 for column in COLUMNS)
    assert min(ours) > 60.0


def test_a_disk_alone_is_sent_straight_to_its_place() -> None:
    alone = replace(guidance.RANDOM, disks=1)
    assert all(guidance.cosines(OURS["loi"], alone, seed).item() > 0.99 for seed in range(8))


def test_the_guidance_of_many_disks_is_measured_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "table1.md"
    page.write_text("<!-- guidance -->\n<!-- end -->\nafter\n")
    guidance.main(["--quick", "--docs", str(tmp_path)])
    printed = capsys.readouterr().out
    assert printed.count("\n| ours ") == 1
    assert page.read_text() == f"<!-- guidance -->\n\n{printed}\n<!-- end -->\nafter\n"

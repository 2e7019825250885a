"""Tests of the problems of others: structure, budgets and skipped rows, with no demand on what converges."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from examples.external.__main__ import main, problems
from examples.external.disks import DISKS
from examples.external.methods import L1DSSIM, METHODS, RESTARTS
from examples.external.problem import Answer, Method, Problem, Task, needs
from examples.external.running import HEADS, Summary, run, solved_by_problem, summary
from loi_core import FitError
from loi_core.testing import check_objective
from tests.helpers import Host

RENDERS = 60  # of a short run
AVAILABLE = [problem for problem in problems() if not problem.missing()]


def short(problem: Problem) -> Problem:
    return replace(problem, steps=10, renders=RENDERS)


@pytest.mark.parametrize("problem", AVAILABLE, ids=lambda problem: str(problem.name))
def test_starts_are_drawn_from_seeds_and_begin_outside_of_the_tolerance(problem: Problem) -> None:
    first, again, other = (problem.make(seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.target, again.target)
    assert first.distance == again.distance > problem.tolerance
    assert first.distance != other.distance or not np.array_equal(first.target, other.target)


@pytest.mark.parametrize("problem", AVAILABLE, ids=lambda problem: str(problem.name))
def test_a_start_has_a_target_of_the_size_of_its_render_and_starts_within_its_bounds(problem: Problem) -> None:
    start = problem.make(3)
    params = start.renderer.parameters()
    assert tuple(start.renderer.render(params).shape) == start.target.shape
    for name, free in start.free.items():
        assert np.all(np.asarray(free.lower) <= free.initial), name
        assert np.all(np.asarray(free.initial) <= free.upper), name


@pytest.mark.parametrize("method", METHODS, ids=lambda method: str(method.name))
def test_every_method_spends_its_budget_and_hardly_more(method: Method) -> None:
    if method.missing():
        pytest.skip(method.missing())
    outcome = run(short(DISKS[0]), method, 0)
    descents = RESTARTS if method.name == "random restarts" else 1
    assert outcome.renders <= RENDERS + 20 * descents  # the last image of each, and images of its verdict
    assert outcome.solved == (outcome.error <= DISKS[0].tolerance)
    assert (outcome.ok is None) == (not outcome.method.startswith("loi"))


def test_a_problem_without_its_package_is_skipped_with_the_reason() -> None:
    problem = replace(DISKS[0], missing=needs("a_package_that_nobody_has"))
    entry = summary(problem, METHODS[0], [0])
    assert entry.row()[2] == "skipped: needs a_package_that_nobody_has"
    assert len(entry.row()) == len(HEADS)


def test_the_number_of_renders_of_95_percent_counts_unsolved_starts_as_infinite() -> None:
    outcome = run(short(DISKS[0]), METHODS[2], 0)
    reached = [replace(outcome, solved=True, reached=count) for count in range(1, 21)]
    lost = replace(outcome, solved=False, reached=5)
    assert Summary("", "", outcomes=tuple(reached)).renders_of_95_percent == 19.0
    assert Summary("", "", outcomes=(*reached[:19], lost)).renders_of_95_percent == 19.0
    assert Summary("", "", outcomes=(*reached[:18], lost, lost)).renders_of_95_percent is None


def test_the_table_by_problem_has_a_column_for_every_method_that_ran() -> None:
    outcome = replace(run(short(DISKS[0]), METHODS[2], 0), solved=True)
    summaries = [
        Summary("disks", "loi", outcomes=(outcome,)),
        Summary("disks", "kornia", skipped="needs kornia"),
        Summary("shapes", "pixel L2", outcomes=(outcome, outcome)),
    ]
    heads, rows = solved_by_problem(summaries)
    assert heads == ["problem", "loi", "pixel L2"]
    assert rows == [["disks", "1 of 1", ""], ["shapes", "", "2 of 2"]]


def test_a_fit_that_fails_is_an_unsolved_start_with_its_message() -> None:
    def fail(_: Task) -> Answer:
        msg = "the loss is not finite"
        raise FitError(msg)

    outcome = run(DISKS[0], Method("failing", fail), 0)
    assert (outcome.verdict, outcome.solved) == ("failed: the loss is not finite", False)
    assert outcome.error == outcome.distance


def test_the_command_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--problem", "three disks x 0.9", "--method", "pixel L2", "--starts", "1", "--json"])
    (entry,) = json.loads(capsys.readouterr().out)
    assert (entry["problem"], entry["method"], entry["starts"]) == ("three disks x 0.9", "pixel L2", 1)
    assert entry["outcomes"][0]["error"] == entry["median_error"]


def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--problem", "three disks x 1", "--method", "CMA-ES", "--starts", "1", "--quick"])
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert [cell.strip() for cell in table[0].strip("|").split("|")] == list(HEADS)
    assert "three disks x 1" in table[2]


def test_l1_and_dssim_is_an_objective_with_the_gradient_of_its_value() -> None:
    def make(reference: Host) -> L1DSSIM:
        return L1DSSIM(reference)

    check_objective(make)

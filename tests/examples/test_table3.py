"""Tests of Table 3 of the paper: its scenes, the teapot, and its quick tier."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from examples.paper.table3 import main
from examples.paper.table3.problem import COLUMNS, Column, Problem, image_of
from examples.paper.table3.teapot import teapot


@pytest.mark.parametrize("column", COLUMNS, ids=lambda column: column.name)
def test_every_scene_of_table_3_has_its_views_and_a_start_unlike_the_target(column: Column) -> None:
    problem = Problem.of(column, 3)
    assert len(problem.views) == len(problem.matching_views) == len(problem.targets) == column.views
    assert {name: np.shape(value) for name, value in problem.start.items()} == {
        name: np.shape(value) for name, value in problem.goal.items()
    }
    name, view = next(iter(problem.views.items()))
    target = image_of(view, problem.goal)
    np.testing.assert_array_equal(target, problem.targets[name])
    assert float(np.mean((image_of(view, problem.start) - target) ** 2)) > 1e-4
    for parameter, start in problem.start.items():
        lower, upper = problem.bounds(parameter)
        assert lower is None or bool(np.all(lower <= start))
        assert lower is None or bool(np.all(lower <= problem.goal[parameter]))
        assert upper is None or bool(np.all(problem.goal[parameter] <= upper))


def test_the_teapot_encloses_a_volume_and_has_the_requested_radius() -> None:
    # The surface is closed except for the gap under its lid.
    mesh = teapot()
    corners = mesh.vertices.numpy()[mesh.faces]
    volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    assert volume > 0.5
    assert float(mesh.vertices.abs().max()) == pytest.approx(1.0)


def test_the_quick_tier_of_table_3_does_not_repeat_finished_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        main(["--quick", "--out", str(tmp_path)])
        assert "loi (ours)" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"rgbxy_finetune", "loi"}
    assert (tmp_path / "ours-trans-rot.png").exists()
    assert (tmp_path / "ours-convergence.png").exists()


def test_table_3_refuses_an_unknown_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--columns", "Kitten", "--out", str(tmp_path)])
    assert "--columns must be among 'Translation'" in capsys.readouterr().err

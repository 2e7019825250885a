"""Tests of Table 2 of the paper: its scenes, its error for interchangeable objects, and its quick tier."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from examples.paper.figures import teaser
from examples.paper.lib.results import key_of
from examples.paper.table2 import main
from examples.paper.table2.command import SUBTABLES, subtable_of
from examples.paper.table2.problem import COLUMNS, Column, Problem
from examples.paper.table2.scenes import SCENES
from tests.strategies import thorough

# isort: split
import mitsuba as mi


@pytest.fixture(autouse=True)
def variant() -> None:
    """Set a variant, which the transforms of Mitsuba need."""
    mi.set_variant("llvm_ad_rgb")


@pytest.mark.parametrize("column", COLUMNS, ids=lambda column: column.name)
def test_every_start_is_within_its_bounds_and_at_a_distance_from_the_truth(column: Column) -> None:
    starts = []
    for seed in range(4):
        built = SCENES[column.name](16, 12, seed)
        assert set(built.parameters) == set(built.truth) == set(built.start)
        assert all(abs(value) <= built.reach for values in (built.truth, built.start) for value in values.values())
        assert np.mean([abs(built.truth[name] - built.start[name]) for name in built.truth]) > 0.3
        starts.append(tuple(built.start.values()))
    assert len(set(starts)) == len(starts)


def test_no_two_runs_of_table_2_share_a_line_of_the_csv() -> None:
    runs = {run for name in SUBTABLES if name != "savings" for run in subtable_of(name).runs}
    assert len({key_of(run) for run in runs}) == len(runs)


def test_the_sort_scene_has_65_colours_and_130_parameters() -> None:
    built = SCENES["Sort"](16, 12, 0)
    assert len(built.parameters) == 130
    tints = {
        tuple(shape["bsdf"]["bsdf"]["reflectance"]["value"])
        for name, shape in built.scene.items()
        if name.startswith("one_")
    }
    assert len(tints) == 65


def test_no_two_boxes_of_the_sort_scene_have_coplanar_tops() -> None:
    """Where coplanar tops overlap, rounding decides which is visible, and no gradient describes the change."""
    scene = SCENES["Sort"](16, 12, 0).scene
    boxes = [shape for shape in scene.values() if isinstance(shape, dict) and shape["type"] == "cube"]
    tops = sorted((np.array(box["to_world"].matrix) @ [0.0, 1.0, 0.0, 1.0])[1] for box in boxes)
    assert len(tops) > 30
    assert np.min(np.diff(tops)) > 1e-3


def test_primitives_start_near_their_targets_in_one_sort_scene_and_anywhere_in_the_other() -> None:
    """Primitives are half a unit wide, and most starts are too far from the target to overlap."""
    errors = {}
    for name in ("Sort", "Sort, anywhere"):
        built = SCENES[name](16, 12, 0)
        errors[name] = np.array([abs(built.start[key] - built.truth[key]) for key in built.truth]).reshape(-1, 2)
    assert np.max(errors["Sort"]) <= 2.0 < np.max(errors["Sort, anywhere"])
    assert np.mean(np.max(errors["Sort"], axis=1) > 0.5) > 0.9


def test_the_centre_of_a_glass_ball_is_in_view_at_all_corners_of_its_bounds() -> None:
    """A ball out of view has no gradient, and cannot return."""
    built = SCENES["Caustics and Lights"](64, 48, 0)
    sensor = built.scene["sensor"]
    to_camera = np.linalg.inv(np.array(sensor["to_world"].matrix, dtype=np.float64))
    half_extent = np.tan(np.radians(sensor["fov"] / 2.0)) * np.array([1.0, 48 / 64])
    height = np.array(built.scene["ball_1"]["to_world"].matrix)[1, 3]
    for x in (-built.reach, built.reach):
        for z in (-built.reach, built.reach):
            centre = to_camera @ np.array([x, height, z, 1.0])
            assert np.all(np.abs(centre[:2]) < half_extent * centre[2])


def test_glass_balls_are_interchangeable_and_lamps_are_not() -> None:
    problem = Problem(COLUMNS[2], SCENES["Caustics and Lights"](16, 12, 0), None)
    truth = dict(problem.built.truth)

    def exchanged(first: str, second: str) -> dict[str, float]:
        return truth | {
            f"{a}_{axis}": truth[f"{b}_{axis}"] for a, b in ((first, second), (second, first)) for axis in "xz"
        }

    assert problem.error(truth) == 0.0
    assert problem.error(exchanged("ball_1", "ball_2")) == 0.0
    assert problem.error(exchanged("lamp_1", "lamp_2")) > 1.0


def test_the_quick_tier_of_table_2_does_not_repeat_finished_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        main(["--quick", "--out", str(tmp_path)])
        printed = capsys.readouterr().out
        assert "loi (ours)" in printed
        assert "## cost, ours" in printed
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"prdpt", "loi"}
    assert (tmp_path / "ours-envlight.png").exists()
    assert (tmp_path / "ours-convergence.png").exists()


def test_table_2_refuses_an_unknown_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--columns", "Caustics", "--out", str(tmp_path)])
    assert "--columns must be among 'Shadow'" in capsys.readouterr().err


@thorough
def test_the_teaser_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    teaser.main(["--quick", "--out", str(tmp_path)])
    assert "| loi (ours) | (" in capsys.readouterr().out
    assert (tmp_path / "teaser.png").stat().st_size > 10_000

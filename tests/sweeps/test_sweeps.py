"""Sweeps: every run once, whatever happens to some runs, and one table of all runs."""

from __future__ import annotations

import csv
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.errors import ExecutorError, InUseError, LoiError, OptionError, SceneError
from loi_core.io.images import read_image, write_png
from loi_core.runs import RunResult, Workers, processes
from loi_core.support.installed import how_to_install
from loi_core.sweeps import sweep
from loi_core.sweeps.fit_task import scene_error
from loi_core.sweeps.folder import SweepFolder
from loi_core.sweeps.plan import SweepRun
from loi_core.sweeps.reading import read_sweep
from tests.environments import ROOT
from tests.sweeps.scenes import SCENE, SWEEP, lay_out, outcome, outcome_here, records


@pytest.fixture
def done(finished: Path, tmp_path: Path) -> Path:
    """Return a copy of the finished sweep, for changes."""
    shutil.copytree(finished.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / finished.name


def no_process(*_: Any, **__: Any) -> None:
    msg = "a process was started"
    raise AssertionError(msg)


def test_every_run_equals_its_execution_in_one_process_to_the_bit(finished: Path, tmp_path: Path) -> None:
    output = finished.parent / "sweep-result"
    finished_runs = records(output)
    assert len(finished_runs) == 8
    for name, record in finished_runs.items():
        assert outcome(record, output / "runs" / name) == outcome_here(finished, name, tmp_path)


def test_finished_runs_leave_no_checkpoint(finished: Path) -> None:
    for folder in (finished.parent / "sweep-result" / "runs").iterdir():
        left = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        assert not any("checkpoint" in name for name in left)
        assert "loi-fit.json" in left


def test_a_sweep_varies_exactly_the_listed_keys(finished: Path) -> None:
    runs = read_sweep(finished).runs
    assert list(runs[0].varied) == ["objective.name", "optimise.positions.learning_rate", "start"]
    assert [tuple(run.varied.values()) for run in runs] == [
        (name, rate, start) for start in (0, 1) for name in ("loi", "pixel_l2") for rate in (1, 2.5)
    ]
    assert runs[1].document["optimise"]["positions"] == {
        "initial": [[4, 12]],
        "lower": 0,
        "upper": 16,
        "truth": [[10, 6]],
        "learning_rate": 2.5,
    }
    assert runs[1].document["fit"] == {"steps": 30, "learning_rate": 1}


def test_finished_runs_are_not_executed_again(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modified = {path: path.stat().st_mtime_ns for path in done.parent.glob("sweep-result/r*/**/*")}
    monkeypatch.setattr(processes, "_Process", no_process)
    assert sweep(done).count("done") == 8
    assert {path: path.stat().st_mtime_ns for path in done.parent.glob("sweep-result/r*/**/*")} == modified


def test_a_change_of_any_dependency_makes_a_new_run(done: Path) -> None:
    def unfinished() -> int:
        plan, folder = read_sweep(done), SweepFolder(done.parent / "sweep-result")
        return sum(folder.read(run) is None for run in plan.runs)

    assert unfinished() == 0
    done.write_text(SWEEP.replace("starts = 2", "starts = 3\ntimeout = 50"))
    assert unfinished() == 4  # the runs of the third start; runs do not depend on the time limit
    done.write_text(SWEEP.replace("[1, 2.5]", "[1, 2.25]"))
    assert unfinished() == 4
    done.write_text(SWEEP)
    (done.parent / "scene.toml").write_text(SCENE.replace("sigma = 1", "sigma = 1.5"))
    assert unfinished() == 8
    (done.parent / "scene.toml").write_text(SCENE)
    write_png(done.parent / "target.png", 0.5 * read_image(done.parent / "target.png"))
    assert unfinished() == 8


def test_seeds_are_far_apart_and_starts_lie_within_the_bounds(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\nseeds = 2\nstarts = 2\n')
    runs = read_sweep(path).runs
    assert [(run.varied["fit.seed"], run.start) for run in runs] == [(k, j) for j in (0, 1) for k in (0, 10**6)]
    assert [run.document["fit"]["seed"] for run in runs[:2]] == [0, 10**6]
    result = sweep(path, processes=2)
    starts = {
        row["start"]: read_image(tmp_path / "sweep-result" / "runs" / row["run"] / "initial.png") for row in result.rows
    }
    assert len({image.tobytes() for image in starts.values()}) == 2
    by_seed = [sorted(row["psnr"] for row in result.rows if row["fit.seed"] == seed) for seed in (0, 10**6)]
    assert by_seed[0] == by_seed[1]  # nothing is random in this renderer


def test_the_table_has_a_row_for_each_run(finished: Path) -> None:
    folder = finished.parent / "sweep-result"
    with (folder / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 8
    finished_runs = records(folder)
    for row in rows:
        record = finished_runs[row["run"]]
        assert row["status"] == "done"
        assert float(row["psnr"]) == record["psnr"]
        assert float(row["error.positions"]) == record["errors"]["positions"]
        assert row["objective.name"] == record["objective"]
        assert float(row["optimise.positions.learning_rate"]) in (1.0, 2.5)


def test_the_page_ranks_settings_by_their_mean_and_is_self_contained(finished: Path) -> None:
    result = sweep(finished)
    means = [standing.mean for standing in result.standings]
    assert means == sorted(means, reverse=True)
    for standing in result.standings:
        scores = [
            row["psnr"] for row in result.rows if all(str(row[key]) == value for key, value in standing.setting.items())
        ]
        assert standing.mean == pytest.approx(np.mean(scores))
        assert standing.worst == min(scores)
        assert standing.best is not None
        assert standing.best["psnr"] == max(scores)
    page = result.page.read_text()
    assert page.count("data:image/png;base64,") == 3 * len(result.standings) == 12
    assert "color-scheme: light dark" in page
    assert re.findall(r'src="(?!data:)|<link|<script|https?:', page) == []
    for link in re.findall(r'href="([^"]+)"', page):
        assert (result.page.parent / link).exists()


def test_a_ranking_by_errors_starts_with_the_lowest(done: Path) -> None:
    done.write_text(f'rank = "error.positions"\n{SWEEP}')
    means = [standing.mean for standing in sweep(done).standings]
    assert means == sorted(means)


def test_failed_runs_are_listed_with_their_cause_and_retried_on_request(
    done: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = done.parent / "sweep-result"
    name = sorted(records(folder))[0]
    (folder / "records" / f"{name}.json").unlink()
    shutil.rmtree(folder / "runs" / name)
    (folder / "runs" / name).mkdir()
    foreign_file = folder / "runs" / name / "thesis.tex"
    foreign_file.write_text("x")
    assert main(["sweep", str(done), "--processes", "1"]) == 1
    printed = capsys.readouterr()
    assert f"loi: {name} failed: OptionError: `output` must be a new or empty folder" in printed.err
    assert "7 runs done, 1 failed; `--retry-failed`" in printed.out
    assert "thesis.tex" in (folder / "leaderboard.html").read_text()
    foreign_file.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(processes, "_Process", no_process)
        assert main(["sweep", str(done)]) == 1
    assert main(["sweep", str(done), "--retry-failed", "--processes", "1"]) == 0
    assert "8 runs done, 0 failed" in capsys.readouterr().out


def test_ctrl_c_keeps_finished_runs_and_the_same_call_continues(tmp_path: Path) -> None:
    path = lay_out(tmp_path, SWEEP.replace("starts = 2", "starts = 1"))
    # A test run in the background may ignore Ctrl-C, and its children would too.
    set_handler = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = f"import runpy, signal; {set_handler}; runpy.run_module('loi_core', run_name='__main__')"
    program = subprocess.Popen(
        [sys.executable, "-c", command, "sweep", str(path), "--processes", "1"],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    while not records(tmp_path / "sweep-result") and program.poll() is None:
        time.sleep(0.02)
    program.send_signal(signal.SIGINT)
    _, errors = program.communicate(timeout=60)
    finished_runs = records(tmp_path / "sweep-result")
    assert program.returncode == 1
    assert errors == f"loi: interrupted; {len(finished_runs)} of 4 runs are finished, the same call continues\n"
    assert 1 <= len(finished_runs) < 4
    with (tmp_path / "sweep-result" / "sweep.csv").open(newline="") as stream:
        assert [row["status"] for row in csv.DictReader(stream)].count("missing") == 4 - len(finished_runs)
    totals: list[int] = []
    assert sweep(path, processes=2, progress=lambda *counts: totals.append(counts[1])).count("done") == 4
    assert set(totals) == {4 - len(finished_runs)}


def test_an_interrupt_after_a_record_was_written_counts_its_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay_out(tmp_path)
    write = SweepFolder.write

    def write_and_interrupt(folder: SweepFolder, run: SweepRun, content: dict[str, Any]) -> None:
        write(folder, run, content)
        raise KeyboardInterrupt

    monkeypatch.setattr(SweepFolder, "write", write_and_interrupt)
    with pytest.raises(KeyboardInterrupt, match="interrupted; 1 of 8 runs"):
        sweep(path, processes=1)
    with (tmp_path / "sweep-result" / "sweep.csv").open(newline="") as stream:
        assert [row["status"] for row in csv.DictReader(stream)].count("missing") == 7


def test_a_second_sweep_in_the_same_folder_is_refused(done: Path) -> None:
    with (
        SweepFolder(done.parent / "sweep-result").locked(),
        pytest.raises(InUseError, match=r"sweep-result is in use by another fit"),
    ):
        sweep(done)
    sweep(done)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('scenes = "scene.toml"', "unknown key `scenes`; did you mean `scene`?"),
        ("seeds = 2", "`scene` is missing"),
        ("scene = []", "`scene` must be the path of a scene file, or a list of them, got \\[\\]"),
        ('scene = "none.toml"', "none.toml: no such scene file"),
        ('scene = "scene.toml"\nseeds = 0', "`seeds` must be their number, 1 or more, or a list of seeds, got 0"),
        ('scene = "scene.toml"\nseeds = [1, -1]', "`seeds` must be"),
        ('scene = "scene.toml"\nstarts = true', "`starts` must be a whole number from 1 to 4096, got True"),
        ('scene = "scene.toml"\ntimeout = 0', "`timeout` must be a number of seconds, more than 0"),
        (
            'scene = "scene.toml"\nrank = "error.nope"',
            "`rank` is by the error of 'nope'; the scenes have a `truth` of 'positions'",
        ),
        ('scene = "scene.toml"\nrank = "ssim"', "`rank` must be 'psnr', 'value', 'seconds' or 'error.PARAMETER'"),
        ('scene = "scene.toml"\noutput = "../elsewhere"', "`output` must lie in the folder of the sweep"),
        ('scene = "scene.toml"\noutput = "."', "`output` must be a folder of its own"),
        ('scene = "scene.toml"\n[vary]\nsteps = [1]', "\\[vary\\] unknown key `steps`; known are target"),
        ('scene = "scene.toml"\n[vary]\n"fit.steps" = [1]', "`fit.steps` is one key in quotes; write it without"),
        ('scene = "scene.toml"\n[vary]\nfit.steps = 3', "`fit.steps` must be a list of values to take in turn, got 3"),
        ('scene = "scene.toml"\n[vary]\nfit.steps = []', "`fit.steps` must be a list"),
        (
            'scene = "scene.toml"\n[vary]\ntarget.x = [1]',
            "`target.x` leads through a value that is not a table in scene.toml",
        ),
        ('scene = "scene.toml"\nseeds = 2\n[vary]\nfit.seed = [1]', "`seeds` and `fit.seed` of \\[vary\\] exclude"),
        ('scene = "scene.toml"\nseeds = 400\nstarts = 400', "a sweep may have 100000 runs, got 160000"),
        (
            'scene = "scene.toml"\n[vary]\nfit.stepz = [1]',
            "scene.toml: \\[fit\\] unknown key `stepz`; did you mean `ste",
        ),
        ('scene = "scene.toml"\n[vary]\nfit.steps = [1, -3]', "`steps` must be a whole number, 1 or more, got -3"),
    ],
)
def test_a_mistake_in_a_sweep_is_one_line_and_nothing_is_written(tmp_path: Path, change: str, message: str) -> None:
    path = lay_out(tmp_path, f"{change}\n")
    files = sorted(tmp_path.rglob("*"))
    with pytest.raises(LoiError, match=message) as caught:
        sweep(path, processes=1)
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == files


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    (tmp_path / "sweep-result").mkdir()
    (tmp_path / "sweep-result" / "thesis.tex").touch()
    with pytest.raises(OptionError, match=r"holds 'thesis.tex' and no loi-sweep.json"):
        sweep(path)


def test_several_scenes_are_compared_as_settings(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = ["scene.toml", "short.toml"]\n')
    (tmp_path / "short.toml").write_text(SCENE.replace("steps = 30", "steps = 3"))
    result = sweep(path, processes=2)
    assert [standing.setting for standing in result.standings] == [{"scene": "scene.toml"}, {"scene": "short.toml"}]
    assert [row["steps"] for row in result.rows] == [30, 3]


def test_a_missing_or_unreachable_dask_is_reported_on_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = lay_out(tmp_path)
    assert main(["sweep", str(path), "--dask", "nonsense"]) == 1
    assert capsys.readouterr().err.startswith("loi: no Dask scheduler answers at 'nonsense'")
    assert main(["sweep", str(path), "--dask", "tcp://127.0.0.1:1", "--processes", "2"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExecutorError, match=re.escape(f"need the package distributed: {how_to_install('dask')}")):
        Workers(dask="tcp://127.0.0.1:1")


def test_many_seeds_are_checked_by_few_tasks_and_a_wrong_seed_is_detected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\nseeds = 300\n')
    submitted: list[Any] = []

    class Counted(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            submitted.append(args)
            return super().submit(lambda: RunResult(args[2], "" if args[1] is scene_error else {"cause": ""}))

    with monkeypatch.context() as patch:
        patch.setattr("loi_core.runs.workers.ThreadPoolExecutor", Counted)
        assert sweep(path, processes=1).count("done") == 300
    assert 300 <= len(submitted) < 320
    path.write_text('scene = "scene.toml"\nseeds = [1, 2, 3, 4611686018427387904123]\n')
    with pytest.raises(SceneError, match="`seed` must be"):
        sweep(path, output=tmp_path / "another", processes=1)


def test_a_scene_error_names_its_run(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\n[vary]\nobjective.name = ["loi", "l3"]\n')
    with pytest.raises(SceneError, match=r"got 'l3' \(run name-l3-[0-9a-f]{12} of sweep.toml\)"):
        sweep(path, processes=1)

"""Sweeps: every run once, whatever happens to some of them, and one table of all."""

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
from loi_core.runs import DaskExecutor, RunResult, processes
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
    """A copy of the finished sweep, to be changed."""
    shutil.copytree(finished.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / finished.name


def no_process(*_: Any, **__: Any) -> None:
    msg = "a process was started"
    raise AssertionError(msg)


def test_every_run_comes_out_as_in_one_process_to_the_bit(finished: Path, tmp_path: Path) -> None:
    output = finished.parent / "sweep-result"
    found = records(output)
    assert len(found) == 8
    for name, record in found.items():
        assert outcome(record, output / "runs" / name) == outcome_here(finished, name, tmp_path)


def test_runs_that_are_done_leave_no_checkpoint(finished: Path) -> None:
    for folder in (finished.parent / "sweep-result" / "runs").iterdir():
        left = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        assert not any("checkpoint" in name for name in left)
        assert "loi-fit.json" in left


def test_a_sweep_varies_what_it_says_and_leaves_the_rest(finished: Path) -> None:
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


def test_what_is_done_is_not_done_again(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path: path.stat().st_mtime_ns for path in done.parent.glob("sweep-result/r*/**/*")}
    monkeypatch.setattr(processes, "_Process", no_process)
    assert sweep(done).count("done") == 8
    assert {path: path.stat().st_mtime_ns for path in done.parent.glob("sweep-result/r*/**/*")} == before


def test_a_run_is_another_one_once_anything_that_it_depends_on_changes(done: Path) -> None:
    def left() -> int:
        plan, folder = read_sweep(done), SweepFolder(done.parent / "sweep-result")
        return sum(folder.read(run) is None for run in plan.runs)

    assert left() == 0
    done.write_text(SWEEP.replace("starts = 2", "starts = 3\ntimeout = 50"))
    assert left() == 4  # those of the third start; a limit of time is not what a run depends on
    done.write_text(SWEEP.replace("[1, 2.5]", "[1, 2.25]"))
    assert left() == 4
    done.write_text(SWEEP)
    (done.parent / "scene.toml").write_text(SCENE.replace("sigma = 1", "sigma = 1.5"))
    assert left() == 8
    (done.parent / "scene.toml").write_text(SCENE)
    write_png(done.parent / "target.png", 0.5 * read_image(done.parent / "target.png"))
    assert left() == 8


def test_seeds_are_far_apart_and_starts_lie_within_the_bounds(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\nseeds = 2\nstarts = 3\n')
    runs = read_sweep(path).runs
    assert [(run.varied["fit.seed"], run.start) for run in runs] == [(k, j) for j in (0, 1, 2) for k in (0, 10**6)]
    assert [run.document["fit"]["seed"] for run in runs[:2]] == [0, 10**6]
    found = sweep(path, processes=2)
    starts = {
        row["start"]: read_image(tmp_path / "sweep-result" / "runs" / row["run"] / "initial.png") for row in found.rows
    }
    assert len({image.tobytes() for image in starts.values()}) == 3
    by_seed = [sorted(row["psnr"] for row in found.rows if row["fit.seed"] == seed) for seed in (0, 10**6)]
    assert by_seed[0] == by_seed[1]  # nothing is random in this renderer


def test_the_table_has_a_row_for_each_run_in_csv_and_in_parquet(finished: Path) -> None:
    from pyarrow import parquet

    folder = finished.parent / "sweep-result"
    with (folder / "sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 8
    assert {row["status"] for row in rows} == {"done"}
    found = records(folder)
    table = parquet.read_table(folder / "sweep.parquet").to_pylist()
    for row, other in zip(rows, table, strict=True):
        record = found[row["run"]]
        assert float(row["psnr"]) == other["psnr"] == record["psnr"]
        assert float(row["error.positions"]) == other["error.positions"] == record["errors"]["positions"]
        assert row["objective.name"] == other["objective.name"] == record["objective"]
        assert float(row["optimise.positions.learning_rate"]) == other["optimise.positions.learning_rate"]


def test_without_pyarrow_the_table_is_csv(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (done.parent / "sweep-result" / "sweep.parquet").unlink()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert sweep(done).table.exists()
    assert not (done.parent / "sweep-result" / "sweep.parquet").exists()


def test_the_page_ranks_settings_by_their_mean_and_needs_no_other_file(finished: Path) -> None:
    found = sweep(finished)
    means = [one.mean for one in found.standings]
    assert means == sorted(means, reverse=True)
    for one in found.standings:
        scores = [
            row["psnr"] for row in found.rows if all(str(row[key]) == value for key, value in one.setting.items())
        ]
        assert one.mean == pytest.approx(np.mean(scores))
        assert one.worst == min(scores)
        assert one.best is not None
        assert one.best["psnr"] == max(scores)
    page = found.page.read_text()
    assert page.count("data:image/png;base64,") == 3 * len(found.standings) == 12
    assert "color-scheme: light dark" in page
    assert re.findall(r'src="(?!data:)|<link|<script|https?:', page) == []
    for link in re.findall(r'href="([^"]+)"', page):
        assert (found.page.parent / link).exists()


def test_a_rank_of_errors_is_lowest_first(done: Path) -> None:
    done.write_text(f'rank = "error.positions"\n{SWEEP}')
    means = [one.mean for one in sweep(done).standings]
    assert means == sorted(means)


def test_what_failed_is_listed_with_its_cause_and_done_again_only_when_asked(
    done: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = done.parent / "sweep-result"
    name = sorted(records(folder))[0]
    (folder / "records" / f"{name}.json").unlink()
    shutil.rmtree(folder / "runs" / name)
    (folder / "runs" / name).mkdir()
    stranger = folder / "runs" / name / "thesis.tex"
    stranger.write_text("x")
    assert main(["sweep", str(done), "--processes", "1"]) == 1
    said = capsys.readouterr()
    assert f"loi: {name} failed: OptionError: `output` must be a new or empty folder" in said.err
    assert "7 runs done, 1 failed; `--retry-failed`" in said.out
    assert "thesis.tex" in (folder / "leaderboard.html").read_text()
    stranger.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(processes, "_Process", no_process)
        assert main(["sweep", str(done)]) == 1
    assert main(["sweep", str(done), "--retry-failed", "--processes", "1"]) == 0
    assert "8 runs done, 0 failed" in capsys.readouterr().out


def test_ctrl_c_keeps_what_has_ended_and_the_same_call_goes_on(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    # A test run in the background may ignore Ctrl-C, and its children would too.
    heeds = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = f"import runpy, signal; {heeds}; runpy.run_module('loi_core', run_name='__main__')"
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
    _, said = program.communicate(timeout=60)
    kept = records(tmp_path / "sweep-result")
    assert program.returncode == 1
    assert said == f"loi: interrupted; {len(kept)} of 8 runs are finished, the same call continues\n"
    assert 1 <= len(kept) < 8
    with (tmp_path / "sweep-result" / "sweep.csv").open(newline="") as stream:
        assert [row["status"] for row in csv.DictReader(stream)].count("missing") == 8 - len(kept)
    ended: list[int] = []
    assert sweep(path, processes=2, progress=lambda *counts: ended.append(counts[1])).count("done") == 8
    assert set(ended) == {8 - len(kept)}


def test_an_interrupt_right_after_a_record_is_written_counts_that_run(
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


def test_two_sweeps_do_not_work_in_one_folder(done: Path) -> None:
    with (
        SweepFolder(done.parent / "sweep-result").locked(),
        pytest.raises(InUseError, match=r"sweep-result is in use by another fit"),
    ):
        sweep(done)
    sweep(done)


@pytest.mark.parametrize(
    ("change", "says"),
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
def test_a_wrong_sweep_is_one_line_and_nothing_is_written(tmp_path: Path, change: str, says: str) -> None:
    path = lay_out(tmp_path, f"{change}\n")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(LoiError, match=says) as caught:
        sweep(path, processes=1)
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_somebody_keeps_files_in_is_refused(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    (tmp_path / "sweep-result").mkdir()
    (tmp_path / "sweep-result" / "thesis.tex").touch()
    with pytest.raises(OptionError, match=r"holds 'thesis.tex' and no loi-sweep.json"):
        sweep(path)


def test_several_scenes_are_compared_as_settings(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = ["scene.toml", "other.toml"]\n')
    (tmp_path / "other.toml").write_text(SCENE.replace("steps = 30", "steps = 3"))
    found = sweep(path, processes=2)
    assert [one.setting for one in found.standings] == [{"scene": "scene.toml"}, {"scene": "other.toml"}]
    assert [row["steps"] for row in found.rows] == [30, 3]


def test_dask_that_is_missing_or_does_not_answer_is_told_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = lay_out(tmp_path)
    assert main(["sweep", str(path), "--dask", "nonsense"]) == 1
    assert capsys.readouterr().err.startswith("loi: no Dask scheduler answers at 'nonsense'")
    assert main(["sweep", str(path), "--dask", "tcp://127.0.0.1:1", "--processes", "2"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExecutorError, match=re.escape(f"need the package distributed: {how_to_install('dask')}")):
        DaskExecutor("tcp://127.0.0.1:1")


def test_many_seeds_are_checked_by_few_processes_and_a_wrong_one_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\nseeds = 300\n')
    begun: list[Any] = []

    class Counted(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            begun.append(args)
            return super().submit(lambda: RunResult(args[2], "" if args[1] is scene_error else {"cause": ""}))

    with Counted(1) as executor:
        assert sweep(path, executor=executor).count("done") == 300
    assert 300 <= len(begun) < 320
    path.write_text('scene = "scene.toml"\nseeds = [1, 2, 3, 4611686018427387904123]\n')
    with pytest.raises(SceneError, match="`seed` must be"):
        sweep(path, output=tmp_path / "another", processes=1)


def test_a_scene_error_names_its_run(tmp_path: Path) -> None:
    path = lay_out(tmp_path, 'scene = "scene.toml"\n[vary]\nobjective.name = ["loi", "l3"]\n')
    with pytest.raises(SceneError, match=r"got 'l3' \(run name-l3-[0-9a-f]{12} of sweep.toml\)"):
        sweep(path, processes=1)

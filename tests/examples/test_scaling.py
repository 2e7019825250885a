"""The benchmark of scaling: pretend workers are taken for real ones, and the model keeps to what it is made of."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import scaling
from benchmarks.costs import Costs
from benchmarks.sweeps import simulate
from tests.helpers import by_arrays

COSTS = Costs(before=1e-3, after=1e-3, client=2e-3, scheduler=4e-3, worker=0.5, start=5.0)


def test_a_sweep_goes_over_the_scheduler_of_dask_to_pretend_workers_side_by_side() -> None:
    pytest.importorskip("distributed")
    with by_arrays():
        found = simulate(workers=40, fit=1.0, runs=80)
    assert 1.0 <= found.seconds < 20.0  # two rounds of half a second or more, where one worker would take 80 s
    assert min(found.client, found.scheduler, found.crowd) > 0.0
    assert found.join < 60.0


def test_the_model_is_bound_by_the_fits_or_by_whoever_sees_every_run() -> None:
    assert COSTS.carried_out(1000, 10, 60.0) == pytest.approx(5.0 + 100 * 60.5 + 30.0, rel=1e-3)
    assert COSTS.carried_out(100000, 10000, 1.0) == pytest.approx(5.0 + 100000 * 4e-3 + 0.5, rel=1e-3)
    for workers in (1, 10, 100, 1000, 10000):
        enough = COSTS.shortest(workers)
        fit = enough + 1.0
        busy = COSTS.carried_out(10 * workers, workers, fit) - COSTS.start
        assert busy == pytest.approx(10 * (fit + COSTS.worker) + 0.5 * fit, rel=1e-2)
        assert COSTS.seconds(10 * workers, workers, 1.0) >= COSTS.seconds(10 * workers, 10 * workers, 1.0)


def test_what_a_run_costs_in_files_is_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scaling.json"
    with by_arrays():
        assert scaling.main(["--parts", "store", "--stored", "50", "--json", str(path)]) == 0
    assert "| read a record, ms a run |" in capsys.readouterr().out
    written = json.loads(path.read_text())
    assert written["store"]["bytes of a task"] < 4096  # the path of a photograph, and not what is in it
    assert written["costs"]["before"] > 0.0

"""Shared by the tests of sweeps: a small scene, and the results of its fits."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from loi_core.sweeps.fit_task import FitTask, run_fit
from loi_core.sweeps.reading import read_sweep
from tests.one_disk import DISK_TO_FIND, lay_out_disk

SCENE = f"""\
target = "target.png"

{DISK_TO_FIND}
[fit]
steps = 30
learning_rate = 1
"""
SWEEP = """\
scene = "scene.toml"
starts = 2

[vary]
objective.name = ["loi", "pixel_l2"]
optimise.positions.learning_rate = [1, 2.5]
"""
TIMES = ("seconds",)  # differ between two executions of the same run


def lay_out(folder: Path, sweep: str = SWEEP) -> Path:
    """Write a scene, its target and a sweep; return the path of the sweep file."""
    lay_out_disk(folder, SCENE)
    (folder / "sweep.toml").write_text(sweep)
    return folder / "sweep.toml"


def records(output: Path) -> dict[str, dict[str, Any]]:
    """Return the records of finished runs by name."""
    return {path.stem: json.loads(path.read_text()) for path in (output / "records").glob("*.json")}


def outcome(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the result of a run without times: its numbers, its parameters and its final image."""
    return {name: value for name, value in record.items() if name not in ("run", *TIMES)} | {
        name: (folder / name).read_bytes() for name in ("parameters.json", "final.png")
    }


def outcome_here(path: Path, name: str, output: Path) -> dict[str, Any]:
    """Execute a run of a sweep file in this process and return its result."""
    plan = read_sweep(path)
    run = next(candidate for candidate in plan.runs if candidate.name == name)
    task = FitTask(name, run.scene, run.document, run.start, output / name)
    return outcome(run_fit(task), output / name)

"""A fit that is stopped at any moment and resumed leaves the same files as an uninterrupted fit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.environments import ROOT
from tests.frameworks import load
from tests.strategies import THOROUGH, thorough
from tests.survival.processes import environment, fit_killed_and_whole, start, wait_for
from tests.survival.scenes import lay_out

forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="forked children are fast to start")


def outcome_of(folder: Path, *arguments: str) -> dict[str, Any]:
    """Return what :mod:`tests.survival.children` prints."""
    command = [sys.executable, "-m", "tests.survival.children", str(folder), *arguments]
    process = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment(), check=False)
    assert process.returncode == 0, process.stderr
    return dict(json.loads(process.stdout))


def endless_scene(folder: Path) -> Path:
    scene = lay_out(folder, "disks")
    scene.write_text(scene.read_text().replace("steps = 40", "steps = 100000").replace("starts = 2", "starts = 1"))
    return scene


@forks
@pytest.mark.parametrize(
    ("scene", "kills"),
    [
        ("disks", 100 if THOROUGH else 8),
        ("views", 80 if THOROUGH else 3),
        pytest.param("torch", 20, marks=thorough),
    ],
)
def test_a_killed_and_resumed_fit_leaves_the_files_of_an_uninterrupted_one(
    scene: str, kills: int, tmp_path: Path
) -> None:
    if scene == "torch":
        load("torch")
    outcome = outcome_of(tmp_path, scene, "kill", str(kills))
    assert outcome["stopped"] >= kills
    assert outcome["differences"] == {}


@forks
@pytest.mark.parametrize(
    ("how", "reason"),
    [("full", "No space left on device"), pytest.param("read-only", "Read-only file sys", marks=thorough)],
)
def test_a_full_disk_ends_a_fit_with_the_name_of_the_file_and_loses_nothing(
    how: str, reason: str, tmp_path: Path
) -> None:
    outcome = outcome_of(tmp_path, "disks", "starve", how, "10000" if THOROUGH else "4")
    assert outcome["stopped"] >= 4
    assert outcome["differences"] == {}
    for message in outcome["messages"].values():
        assert message.startswith("exit 1: loi: ")
        assert f"could not be written: {reason}" in message
        assert all(line.startswith("loi: ") for line in message.removeprefix("exit 1: ").splitlines())
        assert "`--resume` continues the fit" in message or "/.loi-lock could not be written" in message


def test_sigterm_ends_a_fit_with_its_result_as_ctrl_c_does(tmp_path: Path) -> None:
    fit = start(endless_scene(tmp_path), tmp_path / "result")
    wait_for(tmp_path / "result" / "checkpoint.npz", fit)
    fit.send_signal(signal.SIGTERM)
    message = fit.communicate(timeout=120)[1]
    assert fit.returncode == 1
    assert message == "loi: loi (ours): interrupted; `--resume` continues the fit\n"
    (trial,) = json.loads((tmp_path / "result" / "result.json").read_text())["trials"][:1]
    assert trial["error"] == "interrupted"
    with np.load(tmp_path / "result" / "checkpoint.npz") as stored:
        assert len(stored["history"]) == trial["steps_done"] >= 25
    assert not list((tmp_path / "result").glob(".*"))


def test_only_one_process_resumes_a_folder_and_a_killed_one_leaves_no_lock(tmp_path: Path) -> None:
    scene, output = endless_scene(tmp_path), tmp_path / "result"
    first = start(scene, output)
    wait_for(output / "checkpoint.npz", first)
    second = start(scene, output, "--resume")
    message = second.communicate(timeout=120)[1]
    assert second.returncode == 2
    assert message == f"loi: {output} is in use by another fit; wait until it ends, or stop it\n"
    first.kill()
    first.communicate()
    assert (output / ".loi-lock").exists()
    saved = (output / "checkpoint.npz").stat().st_mtime_ns
    third = start(scene, output, "--resume")
    while (output / "checkpoint.npz").stat().st_mtime_ns == saved:
        assert third.poll() is None
        time.sleep(0.01)
    third.terminate()
    assert third.communicate(timeout=120)[1] == "loi: loi (ours): interrupted; `--resume` continues the fit\n"
    assert not list(output.glob(".*"))


@thorough
def test_a_killed_fit_on_jax_ends_within_a_millionth_of_a_pixel(tmp_path: Path) -> None:
    load("jax")
    resumed, whole = fit_killed_and_whole(lay_out(tmp_path, "JAX"), "positions")
    np.testing.assert_allclose(resumed, whole, atol=1e-6)

"""Whatever kills a fit, and whenever: resumed, it leaves behind what it would have left had nothing happened."""

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
from tests.survival.leftovers import different
from tests.survival.processes import FIT, ends, environment, start, until
from tests.survival.scenes import lay_out

LONG = ("steps = 40", "steps = 100000")
ALONE = ("starts = 2", "starts = 1")

forks = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="children are forked, so that each takes a tenth of a second"
)


def came_of(folder: Path, *arguments: str) -> dict[str, Any]:
    """What :mod:`tests.survival.children` says."""
    command = [sys.executable, "-m", "tests.survival.children", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@forks
@pytest.mark.parametrize(
    ("scene", "kills"),
    [("disks", 100 if THOROUGH else 12), ("views", 80 if THOROUGH else 7), ("torch", 20 if THOROUGH else 1)],
)
def test_a_killed_fit_that_is_resumed_leaves_what_an_unbroken_one_does(scene: str, kills: int, tmp_path: Path) -> None:
    if scene == "torch":
        load("torch")
    found = came_of(tmp_path, scene, "kill", str(kills))
    assert found["cut"] >= kills
    assert found["unlike"] == {}


@forks
@pytest.mark.parametrize(
    ("how", "reason"),
    [("full", "No space left on device"), pytest.param("read-only", "Read-only file sys", marks=thorough)],
)
def test_a_disk_that_fills_ends_a_fit_with_a_named_file_and_loses_nothing(
    how: str, reason: str, tmp_path: Path
) -> None:
    found = came_of(tmp_path, "disks", "starve", how, "10000" if THOROUGH else "4")
    assert found["cut"] >= 4
    assert found["unlike"] == {}
    for said in found["said"].values():
        assert said.startswith("exit 1: loi: ")
        assert f"could not be written: {reason}" in said
        assert all(line.startswith("loi: ") for line in said.removeprefix("exit 1: ").splitlines())
        assert "`--resume` goes on" in said or "/.loi-lock could not be written" in said


@forks
def test_files_that_may_not_grow_end_a_fit_likewise(tmp_path: Path) -> None:
    found = came_of(tmp_path, "disks", "squeeze", "100" if THOROUGH else "5")
    assert found["unlike"] == {}
    for said in found["said"].values():
        assert said.startswith("exit 1: loi: ")
        assert "could not be written: File too large" in said


@pytest.mark.skipif(sys.platform != "linux" or not Path("/usr/bin/unshare").exists(), reason="a disk of our own")
def test_a_disk_that_is_really_full_is_resumed_once_there_is_room(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    scene = lay_out(tmp_path, "disks")
    own = ["unshare", "--user", "--map-root-user", "--mount"]
    mount = f"mount -t tmpfs -o size=40k tmpfs {disk}"
    if subprocess.run([*own, "sh", "-c", mount], capture_output=True, check=False).returncode:
        pytest.skip("no disks can be mounted here")
    fit = f"{' '.join(FIT)} {scene} --output {disk}/result"
    script = f"{mount}; {fit}; echo $?; mount -o remount,size=4m {disk}; {fit} --resume; echo $?"
    script += f"; cp -r {disk}/result {tmp_path}/copy"
    done = subprocess.run(
        [*own, "sh", "-c", script], capture_output=True, text=True, cwd=ROOT, env=environment(), check=True
    )
    assert "could not be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert [line for line in done.stdout.splitlines() if line.isdecimal()] == ["1", "0"]
    whole = start(scene, tmp_path / "whole")
    assert (whole.communicate(timeout=300)[1], whole.returncode) == ("", 0)
    assert different(tmp_path / "copy", tmp_path / "whole") == []


def test_sigterm_ends_a_fit_as_ctrl_c_does(tmp_path: Path) -> None:
    scene = lay_out(tmp_path, "disks")
    scene.write_text(scene.read_text().replace(*LONG).replace(*ALONE))
    fit = start(scene, tmp_path / "result")
    until(tmp_path / "result" / "checkpoint.npz", fit)
    fit.send_signal(signal.SIGTERM)
    said = fit.communicate(timeout=120)[1]
    assert fit.returncode == 1
    assert said == "loi: loi (ours): interrupted; `--resume` goes on\n"
    result = json.loads((tmp_path / "result" / "result.json").read_text())
    assert result["trials"][0]["error"] == "interrupted"
    with np.load(tmp_path / "result" / "checkpoint.npz") as stored:
        assert json.loads(str(stored["state"]))["numbers"]["step"] == result["trials"][0]["steps_done"] >= 25
    assert not list((tmp_path / "result").glob(".*"))


def test_of_two_that_resume_a_folder_one_is_refused_and_a_dead_one_refuses_nobody(tmp_path: Path) -> None:
    scene = lay_out(tmp_path, "disks")
    scene.write_text(scene.read_text().replace(*LONG).replace(*ALONE))
    output = tmp_path / "result"
    first = start(scene, output)
    until(output / "checkpoint.npz", first)
    second = start(scene, output, "--resume")
    said = second.communicate(timeout=120)[1]
    assert second.returncode == 2
    assert said.startswith(f"loi: {output} is in use by another fit")
    assert said.count("\n") == 1
    first.kill()
    first.communicate()
    assert (output / ".loi-lock").exists()
    saved = (output / "checkpoint.npz").stat().st_mtime_ns
    third = start(scene, output, "--resume")
    while (output / "checkpoint.npz").stat().st_mtime_ns == saved:
        assert third.poll() is None
        time.sleep(0.01)
    third.terminate()
    assert third.communicate(timeout=120)[1] == "loi: loi (ours): interrupted; `--resume` goes on\n"
    assert not list(output.glob(".*"))


@thorough
def test_a_fit_on_jax_that_was_killed_comes_within_a_millionth_of_a_pixel(tmp_path: Path) -> None:
    load("jax")
    broken, whole = ends(lay_out(tmp_path, "JAX"), "positions")
    np.testing.assert_allclose(broken, whole, atol=1e-6)

"""Fits as users have them: processes of their own."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.environments import ROOT
from tests.helpers import FINISHED

__all__ = ["FIT", "ends", "environment", "start", "until"]

FIT = [sys.executable, "-m", "loi_core", "fit"]


def environment(**more: str) -> dict[str, str]:
    """One thread, so that children can be forked, and nothing to compile."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "adapters")])
    one = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, "PYTHONPATH": paths, "LOI_COMPILED": "0", "MPLBACKEND": "agg", **one, **more}


def start(scene: Path, output: Path, *more: str, **variables: str) -> subprocess.Popen[str]:
    """A fit as users have it."""
    command = [*FIT, str(scene), "--output", str(output), *more]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment(**variables)
    )


def until(path: Path, process: subprocess.Popen[str]) -> None:
    """Wait until there is such a file."""
    while not path.exists():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.002)


def ends(scene: Path, name: str) -> tuple[Any, Any]:
    """Where a parameter ends in a fit that was killed after its first checkpoint and resumed, and in a whole one."""
    folder, found = scene.parent, []
    killed = start(scene, folder / "killed")
    until(folder / "killed" / "checkpoint.npz", killed)
    killed.kill()
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    with np.load(folder / "killed" / "checkpoint.npz") as stored:
        before = stored["history"][:, 1].tolist()
    for output, more in (("killed", ["--resume"]), ("whole", [])):
        fit = start(scene, folder / output, *more)
        said = fit.communicate(timeout=300)[1]
        assert fit.returncode in FINISHED, said
        with (folder / output / "history.csv").open() as stream:
            rows = list(csv.DictReader(stream))
        assert [int(row["step"]) for row in rows] == list(range(len(rows)))
        assert len(rows) > 25
        assert all(row["psnr"] for row in rows)
        if more:
            assert [float(row["value"]) for row in rows[: len(before)]] == before
        found.append(json.loads((folder / output / "parameters.json").read_text())[name])
    assert {path.name for path in (folder / "killed" / "frames").iterdir()} == {
        path.name for path in (folder / "whole" / "frames").iterdir()
    }
    return found[0], found[1]

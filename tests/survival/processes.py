"""Fits as users run them: in processes of their own."""

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

__all__ = ["environment", "fit_killed_and_whole", "start", "wait_for"]


def environment() -> dict[str, str]:
    """Return variables for one thread, so that children can be forked, and for no compilation."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "adapters")])
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, "PYTHONPATH": paths, "LOI_COMPILED": "0", "MPLBACKEND": "agg", **threads}


def start(scene: Path, output: Path, *options: str) -> subprocess.Popen[str]:
    """Start ``loi fit``."""
    command = [sys.executable, "-m", "loi_core", "fit", str(scene), "--output", str(output), *options]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment()
    )


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a file exists."""
    while not path.exists():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.002)


def fit_killed_and_whole(scene: Path, name: str) -> tuple[Any, Any]:
    """Return a parameter's best value after a fit that was killed and resumed, and after an uninterrupted fit."""
    folder, values = scene.parent, []
    killed = start(scene, folder / "killed")
    wait_for(folder / "killed" / "checkpoint.npz", killed)
    killed.kill()
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    with np.load(folder / "killed" / "checkpoint.npz") as stored:
        saved_values = stored["history"][:, 1].tolist()
    for output, options in (("killed", ["--resume"]), ("whole", [])):
        fit = start(scene, folder / output, *options)
        message = fit.communicate(timeout=300)[1]
        assert fit.returncode in FINISHED, message
        with (folder / output / "history.csv").open() as stream:
            rows = list(csv.DictReader(stream))
        assert [int(row["step"]) for row in rows] == list(range(len(rows)))
        if options:
            assert [float(row["value"]) for row in rows[: len(saved_values)]] == saved_values
        values.append(json.loads((folder / output / "parameters.json").read_text())[name])
    return values[0], values[1]

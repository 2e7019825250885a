"""Building the wheel, and empty environments to install it into."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run(*arguments: str | Path, cwd: Path | None = None, **environment: str) -> str:
    """The standard output of a command that has to succeed; its standard error is in the failure."""
    # What importing loi_mitsuba in this process has chosen must not be chosen for another environment.
    inherited = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    done = subprocess.run(
        list(map(str, arguments)), capture_output=True, text=True, cwd=cwd, env={**inherited, **environment}
    )
    assert done.returncode == 0, f"{arguments} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build_wheel(folder: Path) -> Path:
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT)
    return next(folder.glob("loi-*.whl"))


def fresh_python(folder: Path, wheel: Path) -> Path:
    """The Python of an empty environment into which the wheel alone, with what it requires, was installed."""
    run(sys.executable, "-m", "venv", folder)
    python = folder / "bin" / "python"
    run(python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "-c", ROOT / "constraints.txt", wheel)
    return python

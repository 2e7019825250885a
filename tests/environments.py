"""Building the wheel, and empty environments to install it into."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]

TEST_PACKAGES: Final = ("hypothesis", "mpmath", "psutil", "pytest", "scipy")
"""What the tests of the core import beside the core."""


def run(*arguments: str | Path, cwd: Path | None = None, **environment: str) -> str:
    """The standard output of a command that has to succeed; its standard error is in the failure."""
    # What importing loi_mitsuba in this process has chosen must not be chosen for another environment.
    inherited = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    done = subprocess.run(
        list(map(str, arguments)), capture_output=True, text=True, cwd=cwd, env={**inherited, **environment}
    )
    assert done.returncode == 0, f"{arguments} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build_wheel(folder: Path, source: Path = ROOT) -> Path:
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source)
    return next(folder.glob("loi-*.whl"))


def build_sdist(folder: Path) -> Path:
    run(sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", folder, ROOT)
    return next(folder.glob("loi-*.tar.gz"))


def fresh_python(folder: Path, wheel: Path) -> Path:
    """The Python of an empty environment into which the wheel alone, with what it requires, was installed."""
    run(sys.executable, "-m", "venv", folder)
    python = folder / "bin" / "python"
    # Of all that is installed little is imported: what is, Python compiles then.
    quick = ("-q", "--no-compile", "--disable-pip-version-check")
    run(python, "-m", "pip", "install", *quick, "-c", ROOT / "constraints.txt", wheel)
    return python


def copied_python(python: Path, folder: Path) -> Path:
    """The Python of a copy of an environment, which takes a fraction of the time of one more."""
    shutil.copytree(python.parents[1], folder, symlinks=True, dirs_exist_ok=True)
    for script in (folder / "bin").iterdir():
        content = b"" if script.is_symlink() else script.read_bytes()
        if content.startswith(b"#!"):  # and the path of the Python that runs it
            script.write_bytes(content.replace(os.fsencode(python.parents[1]), os.fsencode(folder)))
    return folder / "bin" / "python"


RESOLUTIONS: Final = {"lowest": "lowest-direct", "newest": "highest"}
"""uv's strategy for direct requirements, by name."""


def python_with_versions(
    resolution: str, folder: Path, wheel: Path, *extras: str, base: str | Path = sys.executable
) -> Path:
    """Return the Python of an environment with the lowest or newest versions that the wheel and some extras allow.

    Indirect requirements and test packages are as new as possible.
    """
    run(base, "-m", "venv", "--without-pip", folder)
    python = folder / "bin" / "python"
    install = sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", python, "--only-binary", ":all:"
    # The strategy applies to requirements named directly, so the wheel is installed apart from its requirements.
    chosen = [part for extra in extras for part in ("--extra", extra)]
    run(*install, "--resolution", RESOLUTIONS[resolution], "--requirements", ROOT / "pyproject.toml", *chosen)
    run(*install, "--no-deps", wheel)
    frozen = folder / "frozen.txt"
    frozen.write_text(run(sys.executable, "-m", "uv", "pip", "freeze", "--python", python, "--exclude", "loi"))
    run(*install, "--constraint", frozen, *TEST_PACKAGES)
    return python


def run_copied_tests(python: Path, folder: Path, *names: str, before: str = "") -> str:
    """Run tests from a folder where the sources are not, so that what is tested is what is installed.

    Parameters
    ----------
    python : Path
        Of the environment.
    folder : Path
        Where the tests are copied to.
    names : str
        Files or folders of `tests`.
    before : str
        Code that runs first.
    """
    passed_over = shutil.ignore_patterns("__pycache__")
    for name in ("tests", "benchmarks"):  # some tests run a benchmark
        shutil.copytree(ROOT / name, folder / name, ignore=passed_over, dirs_exist_ok=True)
    (folder / "pytest.ini").write_text("[pytest]\npythonpath = .\naddopts = --import-mode=importlib\n")
    arguments = ["-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", *(f"tests/{name}" for name in names)]
    code = (
        f"{before}\nimport sys, pytest, loi_core\n"
        f"assert 'site-packages' in loi_core.__file__, loi_core.__file__\n"
        f"sys.exit(pytest.main({arguments!r}))"
    )
    return run(python, "-c", code, cwd=folder, PYTHONPATH="", HYPOTHESIS_PROFILE="quick")

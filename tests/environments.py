"""The wheel, and empty environments for it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]

TEST_PACKAGES: Final = ("hypothesis", "mpmath", "psutil", "pytest", "scipy")
"""Packages that the tests of the core import."""


def run(*arguments: str | Path, cwd: Path | None = None, **environment: str) -> str:
    """Run a command that must succeed and return its standard output; a failure shows its standard error."""
    # The LLVM that an import of loi_mitsuba has chosen is not valid for another environment.
    inherited = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    process = subprocess.run(
        list(map(str, arguments)), capture_output=True, text=True, cwd=cwd, env={**inherited, **environment}
    )
    assert process.returncode == 0, f"{arguments} ended with {process.returncode}:\n{process.stdout}\n{process.stderr}"
    return process.stdout


def build_wheel(folder: Path, source: Path = ROOT) -> Path:
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source)
    return next(folder.glob("loi-*.whl"))


def build_sdist(folder: Path) -> Path:
    run(sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", folder, ROOT)
    return next(folder.glob("loi-*.tar.gz"))


def fresh_python(folder: Path, wheel: Path) -> Path:
    """Return the Python of an environment with only the wheel and its requirements."""
    run(sys.executable, "-m", "venv", folder)
    python = folder / "bin" / "python"
    # Few of the installed modules are imported; Python compiles them at import.
    quick = ("-q", "--no-compile", "--disable-pip-version-check")
    run(python, "-m", "pip", "install", *quick, "-c", ROOT / "constraints.txt", wheel)
    return python


def copied_python(python: Path, folder: Path) -> Path:
    """Return the Python of a copy of an environment, which is faster than a new environment."""
    shutil.copytree(python.parents[1], folder, symlinks=True, dirs_exist_ok=True)
    for script in (folder / "bin").iterdir():
        content = b"" if script.is_symlink() else script.read_bytes()
        if content.startswith(b"#!"):  # followed by the path of its Python
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
    chosen = [argument for extra in extras for argument in ("--extra", extra)]
    run(*install, "--resolution", RESOLUTIONS[resolution], "--requirements", ROOT / "pyproject.toml", *chosen)
    run(*install, "--no-deps", wheel)
    frozen = folder / "frozen.txt"
    frozen.write_text(run(sys.executable, "-m", "uv", "pip", "freeze", "--python", python, "--exclude", "loi"))
    run(*install, "--constraint", frozen, *TEST_PACKAGES)
    return python


def run_copied_tests(python: Path, folder: Path, *names: str, setup: str = "") -> str:
    """Run tests from a folder without the sources, so that they test the installed packages.

    Parameters
    ----------
    python : Path
        Python of the environment.
    folder : Path
        Destination of the copied tests.
    names : str
        Files or folders of `tests`.
    setup : str
        Code that runs first.
    """
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("tests", "benchmarks"):  # some tests run a benchmark
        shutil.copytree(ROOT / name, folder / name, ignore=ignored, dirs_exist_ok=True)
    (folder / "pytest.ini").write_text("[pytest]\npythonpath = .\naddopts = --import-mode=importlib\n")
    arguments = ["-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", *(f"tests/{name}" for name in names)]
    code = (
        f"{setup}\nimport sys, pytest, loi_core\n"
        f"assert 'site-packages' in loi_core.__file__, loi_core.__file__\n"
        f"sys.exit(pytest.main({arguments!r}))"
    )
    return run(python, "-c", code, cwd=folder, PYTHONPATH="", HYPOTHESIS_PROFILE="quick")

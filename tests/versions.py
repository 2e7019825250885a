"""Run tests at the lowest or the newest versions that `pyproject.toml` allows.

``python -m tests.versions lowest|newest [EXTRA ...] [--python PYTHON]``; without extras, the core and all extras but
torch, whose wheels for Linux bring gigabytes of CUDA. NumPy 2.5 and JAX 0.12 need Python 3.12 or
later: give ``--python``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.environments import RESOLUTIONS, build_wheel, python_with_versions, run_copied_tests

TESTS: Final = {
    "": ("method", "pixels", "objectives", "renderers", "io", "cameras", "fitting", "cli/test_completion.py"),
    "dask": ("sweeps",),
    "jax": ("adapters/test_jax.py",),
    "mitsuba": ("mitsuba/test_renderer.py",),
    "torch": ("adapters/test_torch.py",),
}
"""Tests by extra; the empty extra is the core."""

DEFAULT_EXTRAS: Final = tuple(name for name in TESTS if name != "torch")


def check(resolution: str, extras: Sequence[str], folder: Path, python: str = sys.executable) -> None:
    """Run the tests of each extra in its own environment.

    Raises
    ------
    AssertionError
        If a test fails, with the output.
    """
    wheel = build_wheel(folder / "dist")
    for extra in extras:
        root = folder / (extra or "core")
        interpreter = python_with_versions(resolution, root / "venv", wheel, *filter(None, [extra]), base=python)
        output = run_copied_tests(interpreter, root, *TESTS[extra])
        print(f"{resolution} {extra or 'core'}: {output.strip().splitlines()[-1]}", flush=True)


def main() -> None:
    """Parse the command line and run the tests."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("resolution", choices=RESOLUTIONS)
    parser.add_argument("extras", nargs="*", metavar="EXTRA", help="dask, jax, mitsuba or torch")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the environments")
    options = parser.parse_args()
    if unknown := set(options.extras) - set(TESTS):
        parser.error(f"EXTRA must be one of {', '.join(filter(None, TESTS))}, got {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as name:
        check(options.resolution, options.extras or DEFAULT_EXTRAS, Path(name), options.python)


if __name__ == "__main__":
    main()

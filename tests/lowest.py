"""Tests at the lowest versions that `pyproject.toml` allows: ``python -m tests.lowest [EXTRA ...]``.

Without arguments, the core and all extras but torch, whose old wheels for Linux bring gigabytes of CUDA, and what needs
torch.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.environments import build_wheel, lowest_python, run_copied_tests

TESTED: Final = {
    "": ("method", "pixels", "objectives", "renderers", "io", "fitting", "cli/test_completion.py"),
    "dask": ("sweeps/test_dask.py",),
    "parquet": ("sweeps/test_sweeps.py",),
    "jax": ("adapters/test_jax.py",),
    "mitsuba": ("mitsuba/test_renderer.py",),
    "torch": ("adapters/test_torch.py",),
}
"""By extra, what is tested with it; the empty one is the core. What uses TensorBoard needs torch as well."""

USUAL: Final = tuple(name for name in TESTED if name != "torch")


def check(extras: Sequence[str], folder: Path) -> None:
    """Run the tests of each extra in an environment of its own; AssertionError with what was said if one fails."""
    wheel = build_wheel(folder / "dist")
    for extra in extras:
        here = folder / (extra or "core")
        python = lowest_python(here / "venv", wheel, *filter(None, [extra]))
        said = run_copied_tests(python, here, *TESTED[extra])
        print(f"{extra or 'core'}: {said.strip().splitlines()[-1]}", flush=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        check(sys.argv[1:] or USUAL, Path(name))

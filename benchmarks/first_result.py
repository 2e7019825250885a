"""Time the way from an empty environment to a right result: ``python -m benchmarks.first_result [PAGE ...]``.

Each page of the guide gets an environment of its own, with the wheel and the extra of the page. Its first program runs
twice, the second time with compiled kernels, and must print the output on the page. Downloads count.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from loi_core.support.markdown import markdown
from tests.docs.blocks import blocks_of
from tests.environments import ROOT, build_wheel, run

PAGES: Final = ("torch", "kornia", "jax", "mitsuba")
"""Pages of the guide; each extra has the name of its page."""

FURTHER_PACKAGES: Final = {"jax": ("optax",)}
"""Packages that a page installs beside its extra."""

MEGABYTE: Final = 10**6


def first_program(page: Path) -> tuple[str, str]:
    """Return the first Python block of a page and the output on the page.

    Raises
    ------
    ValueError
        If no block of text follows.
    """
    blocks = blocks_of(page)
    index = next(index for index, block in enumerate(blocks) if block.language == "python")
    if index + 1 == len(blocks) or blocks[index + 1].language != "text":
        msg = f"the first program of {page.name} has no output on the page"
        raise ValueError(msg)
    return blocks[index].text, blocks[index + 1].text


def installed_seconds(page: str, wheel: Path, folder: Path) -> float:
    """Install the requirements of a page into a new environment, and return the seconds."""
    started = time.perf_counter()
    run(sys.executable, "-m", "venv", folder)
    requirements = [f"{wheel}[{page}]", *FURTHER_PACKAGES.get(page, ())]
    pip = (folder / "bin" / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt")
    run(*pip, *requirements)
    return time.perf_counter() - started


def size_mb(folder: Path) -> float:
    """Return the size of the files of a folder, in megabytes."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / MEGABYTE


def program_seconds(python: Path, program: str, expected: str, folder: Path) -> float:
    """Run a program, check its output, and return the seconds.

    Raises
    ------
    ValueError
        If the program prints something else.
    AssertionError
        If the program fails, with its output.
    """
    started = time.perf_counter()
    printed = run(python, "-c", program, cwd=folder, PYTHONPATH="")
    seconds = time.perf_counter() - started
    if printed != expected:
        msg = f"printed {printed!r}, expected {expected!r}"
        raise ValueError(msg)
    return seconds


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=f"{', '.join(PAGES)} (default: all)")
    options = parser.parse_args()
    if unknown := set(options.pages) - set(PAGES):
        parser.error(f"PAGE must be one of {', '.join(PAGES)}, got {', '.join(sorted(unknown))}")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        wheel = build_wheel(root)
        for page in options.pages or PAGES:
            program, expected = first_program(ROOT / "docs" / "guide" / f"{page}.md")
            environment = root / f"{page}-environment"  # a folder `torch` would be importable
            install = installed_seconds(page, wheel, environment)
            size = size_mb(environment)
            first, second = (program_seconds(environment / "bin" / "python", program, expected, root) for _ in range(2))
            numbers = (install, first, install + first, second)
            rows.append((page, f"{size:.0f}", *(f"{seconds:.0f}" for seconds in numbers)))
    print("\n".join(markdown(["page", "MB", "install, s", "first run, s", "together, s", "second run, s"], rows)))


if __name__ == "__main__":
    main()

"""Tests of the gallery and the notebook: every program fits its target from a start without overlap."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.strategies import thorough

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "examples" / "gallery"
PROGRAMS = sorted(path.stem for path in GALLERY.glob("plot_*.py"))
QUICK = ("plot_numpy_renderer",)
NEEDS = {"jax": "jax", "mesh": "torch", "mitsuba": "mitsuba", "svg": "torch", "torch": "torch"}
"""Required package by the second word of a program's name; other programs need only NumPy."""

REPORT = """
import json, runpy, sys
import matplotlib
matplotlib.use("agg")
import matplotlib.pyplot as plt
sys.path.insert(0, {folder!r})  # as for `python plot_x.py`
names = runpy.run_path({path!r}, run_name="__main__")
film = names["film"]
film.play().save({film!r})
print(json.dumps({{"figures": len(plt.get_fignums()), "frames": len(film.frames), **{{
    name: names[name] for name in ("start_error", "final_error")}}}}))
"""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else thorough) for name in PROGRAMS],
)
def test_a_gallery_program_fits_its_target_and_shows_the_fit(name: str, tmp_path: Path) -> None:
    pytest.importorskip(NEEDS.get(name.split("_")[1], "numpy"))
    code = REPORT.format(folder=str(GALLERY), path=str(GALLERY / f"{name}.py"), film=str(tmp_path / "film.webp"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True)
    *_, summary, last_line = done.stdout.splitlines()
    report = json.loads(last_line)
    assert report["figures"] == 1
    assert report["frames"] >= 50
    assert report["final_error"] < 0.05 * report["start_error"]
    assert re.search(r"\d", summary)
    assert (tmp_path / "film.webp").stat().st_size < 200_000
    first, final, target = frames(tmp_path / "film.webp")
    # No image equals a photograph with noise or with an occluder.
    bound = 0.7 if name == "plot_mask" else 0.2
    assert mean_squared_difference(final, target) < bound * mean_squared_difference(first, target)


def frames(path: Path) -> tuple[Any, Any, Any]:
    """Return the first and the last image of a film, and its target."""
    with Image.open(path) as film:
        pages = []
        for index in (0, getattr(film, "n_frames", 1) - 1):
            film.seek(index)
            pages.append(np.asarray(film.convert("RGB"), dtype=np.float64))
    half = pages[0].shape[1] // 2 - 3
    return pages[0][:, :half], pages[1][:, :half], pages[1][:, -half:]


def mean_squared_difference(first: Any, second: Any) -> float:
    return float(np.mean((first - second) ** 2))


def test_the_gallery_has_a_program_for_every_framework_and_titles_that_sphinx_gallery_reads() -> None:
    assert {name.split("_")[1] for name in PROGRAMS} >= set(NEEDS) | {"numpy"}
    assert set(QUICK) <= set(PROGRAMS)
    for name in PROGRAMS:
        _, title, line, empty, *_ = (GALLERY / f"{name}.py").read_text().splitlines()
        assert line == "=" * len(title), name
        assert not empty, name


def test_the_notebook_runs_end_to_end_and_fits_the_portrait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the kernel picks its inline backend
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    path = ROOT / "examples" / "first_steps.ipynb"
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # none are stored
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output["text"] for output in outputs if "text" in output)
    errors_px = {name: float(error) for name, error in re.findall(r"(\w+): ([\d.]+) px", text)}
    assert errors_px.keys() == {"loop", "fit"}
    assert max(errors_px.values()) < 0.2
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 4

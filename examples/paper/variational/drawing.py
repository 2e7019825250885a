"""Draw the paper's figure of a scene, and the animation of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from PIL import Image

from examples.paper.lib.pictures import animation, moments, row_of, shown_as
from examples.paper.lib.store import load, picture_path
from examples.paper.variational.run import Run, image_at, problem_of
from loi_core.io.files import write_bytes

__all__ = ["animate", "figure"]


def figure(path: Path, folder: Path, rows: Mapping[str, Sequence[Run]], number: int) -> None:
    """Draw the image at start `number`, the final image of each method, and the target, side by side."""
    runs = {name: row[number] for name, row in rows.items() if number < len(row)}
    records = {name: record for name, run in runs.items() if (record := load(folder, run)) is not None}
    if not records:
        return
    first = next(iter(runs.values()))
    problem = problem_of(first.scene, first.size)
    pictures = {"start": shown_as(image_at(problem, problem.start(first.seed)))}
    for name, record in records.items():
        with Image.open(picture_path(folder, runs[name])) as picture:
            pictures[f"{name}, {record['psnr']:.1f} dB"] = picture.convert("RGB")
    pictures["target"] = shown_as(problem.target)
    write_bytes(path, row_of(pictures))


def animate(path: Path, folder: Path, run: Run) -> None:
    """Write an animated WebP of a fit beside its target."""
    record = load(folder, run)
    if record is None:
        return
    problem = problem_of(run.scene, run.size)
    animation(path, [image_at(problem, params) for params in moments(record["path"])], problem.target)

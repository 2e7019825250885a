"""Contact sheets of final images, and convergence plots."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image, ImageDraw

from examples.paper.store import Run, load, picture_path
from loi_core.io.files import write_bytes
from loi_core.report.plots import new_figure

__all__ = ["contact_sheet", "convergence_plot"]

Made = TypeVar("Made", bound=Run)

GAP = 4
GUTTER = 132  # left of the pictures, for the names
LETTERS = 20  # of a name, in a line of the gutter
STRIP = 14  # under each row, for its PSNR
CELL = 128
BACK = (24, 24, 27)
INK = (228, 228, 231)


def contact_sheet(path: Path, folder: Path, rows: Mapping[str, Sequence[Made]], target: Callable[[Made], Any]) -> None:
    """Every run's final image with its PSNR, a row for each name; what `target` gives of its runs stands first."""
    widest = max(map(len, rows.values())) + 1
    sheet = Image.new("RGB", (GUTTER + widest * (CELL + GAP), len(rows) * (CELL + STRIP + GAP)), BACK)
    draw = ImageDraw.Draw(sheet)
    for line, (name, runs) in enumerate(rows.items()):
        top = line * (CELL + STRIP + GAP) + GAP
        draw.text((GAP, top + CELL // 3), textwrap.fill(name, LETTERS), fill=INK)
        wanted = np.rint(255.0 * np.clip(target(runs[0]), 0.0, 1.0)).astype(np.uint8)
        sheet.paste(Image.fromarray(wanted).resize((CELL, CELL), Image.Resampling.BOX), (GUTTER, top))
        draw.text((GUTTER, top + CELL + 1), "target", fill=INK)
        for number, run in enumerate(runs, 1):
            record = load(folder, run)
            if record is None:
                continue
            left = GUTTER + number * (CELL + GAP)
            with Image.open(picture_path(folder, run)) as picture:
                sheet.paste(picture.convert("RGB").resize((CELL, CELL), Image.Resampling.BOX), (left, top))
            draw.text((left, top + CELL + 1), f"{record['psnr']:.1f} dB", fill=INK)
    # 64 colours of this very sheet: disks and their edges stay as they are, and the file is a third as large.
    stream = io.BytesIO()
    sheet.quantize(64).save(stream, format="PNG", optimize=True)
    write_bytes(path, stream.getvalue())


def convergence_plot(path: Path, folder: Path, panels: Mapping[str, Mapping[str, Sequence[Run]]], apart: int) -> None:
    """Mean squared error by step, a panel for each name and a line for each method: geometric mean over seeds.

    Between two points of a curve are `apart` steps.
    """
    figure = new_figure(3.1 * len(panels), 3.2)
    axes: Any = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for place, (column, lines) in zip(axes, panels.items(), strict=True):
        for name, runs in lines.items():
            curves = [record["curve"] for run in runs if (record := load(folder, run)) is not None]
            if curves:
                mean = np.mean(curves, axis=0)
                steps = apart * np.arange(len(mean))
                place.plot(steps, 10.0 ** (-mean / 10.0), label=name)
        place.set(title=column, xlabel="step", yscale="log")
        place.grid(visible=True, alpha=0.25)
        place.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("mean squared error")
    if axes[-1].lines:
        axes[-1].legend(frameon=False, fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    write_bytes(path, stream.getvalue())

"""Contact sheets of final images, and convergence plots."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image, ImageDraw

from examples.paper.lib.store import Run, load, picture_path
from loi_core.io.files import write_bytes
from loi_core.report.plots import new_figure

__all__ = ["animation", "contact_sheet", "convergence_plot", "moments", "row_of", "shown_as"]

Made = TypeVar("Made", bound=Run)

GAP = 4
GUTTER = 132  # left of the pictures, for the names
LETTERS = 20  # of a name, in a line of the gutter
STRIP = 14  # under each row, for its PSNR
CELL = 128
LARGE = 200  # of a picture in a row of a few
SIDE = 200  # of each half of an animation, in pixels across
FRAMES = 26
TIME = 120  # milliseconds of a frame
PAUSE = 1500  # of the last one
BACK = (24, 24, 27)
INK = (228, 228, 231)


def contact_sheet(path: Path, folder: Path, rows: Mapping[str, Sequence[Made]], target: Callable[[Made], Any]) -> None:
    """Every run's final image with its PSNR, a row for each name; what `target` gives of its runs stands first."""
    widest = max(map(len, rows.values())) + 1
    wanted = target(next(iter(rows.values()))[0])
    tall = round(CELL * wanted.shape[0] / wanted.shape[1])
    sheet = Image.new("RGB", (GUTTER + widest * (CELL + GAP), len(rows) * (tall + STRIP + GAP)), BACK)
    draw = ImageDraw.Draw(sheet)
    for line, (name, runs) in enumerate(rows.items()):
        top = line * (tall + STRIP + GAP) + GAP
        draw.text((GAP, top + tall // 3), textwrap.fill(name, LETTERS), fill=INK)
        shown = shown_as(target(runs[0]) if line else wanted)
        sheet.paste(shown.resize((CELL, tall), Image.Resampling.BOX), (GUTTER, top))
        draw.text((GUTTER, top + tall + 1), "target", fill=INK)
        for number, run in enumerate(runs, 1):
            record = load(folder, run)
            if record is None:
                continue
            left = GUTTER + number * (CELL + GAP)
            with Image.open(picture_path(folder, run)) as picture:
                sheet.paste(picture.convert("RGB").resize((CELL, tall), Image.Resampling.BOX), (left, top))
            draw.text((left, top + tall + 1), f"{record['psnr']:.1f} dB", fill=INK)
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


def moments(path: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """The parameters of a fit at a few moments on its way, the first and the last among them."""
    count = len(next(iter(path.values())))
    chosen = np.unique(np.linspace(0, count - 1, min(FRAMES, count)).astype(int))
    return [{name: values[index] for name, values in path.items()} for index in chosen]


def animation(path: Path, images: Iterable[Any], target: Any) -> None:
    """Images of a fit, one after the other, beside its target, as displays want them: a WebP."""
    tall = round(SIDE * target.shape[0] / target.shape[1])
    frames = []
    for image in images:
        frame = Image.new("RGB", (2 * SIDE + GAP, tall), BACK)
        for side, one in enumerate((image, target)):
            frame.paste(shown_as(one).resize((SIDE, tall), Image.Resampling.BICUBIC), (side * (SIDE + GAP), 0))
        frames.append(frame)
    stream = io.BytesIO()
    times = [TIME] * (len(frames) - 1) + [PAUSE]
    frames[0].save(
        stream, "WEBP", save_all=True, append_images=frames[1:], duration=times, loop=0, quality=70, method=4
    )
    write_bytes(path, stream.getvalue())


def shown_as(image: Any) -> Image.Image:
    """An image in [0, 1], as displays want it, of 8 bits."""
    return Image.fromarray(np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8))


def row_of(pictures: Mapping[str, Image.Image]) -> bytes:
    """Square pictures side by side, each with its name under it: a PNG."""
    sheet = Image.new("RGB", (len(pictures) * (LARGE + GAP) - GAP, LARGE + 16), BACK)
    draw = ImageDraw.Draw(sheet)
    for place, (name, picture) in enumerate(pictures.items()):
        left = place * (LARGE + GAP)
        sheet.paste(picture.resize((LARGE, LARGE), Image.Resampling.NEAREST), (left, 0))
        draw.text((left + GAP, LARGE + 2), name, fill=INK)
    stream = io.BytesIO()
    sheet.quantize(192).save(stream, format="PNG", optimize=True)
    return stream.getvalue()

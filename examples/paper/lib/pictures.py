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
from examples.plots import new_figure
from loi_core.io.files import write_bytes

__all__ = ["animation", "contact_sheet", "convergence_plot", "moments", "row_of", "shown_as"]

RunType = TypeVar("RunType", bound=Run)

# Lengths in pixels.
GAP = 4
NAMES_WIDTH = 132  # left of the pictures
MAX_LINE_LETTERS = 20  # of a name
CAPTION_HEIGHT = 14  # below each row of a contact sheet
CELL_WIDTH = 128  # of a picture in a contact sheet
LARGE_SIDE = 200  # of a picture in a row of a few pictures
HALF_WIDTH = 200  # of the image and of the target in an animation
MAX_FRAMES = 26
FRAME_MILLISECONDS = 120
LAST_FRAME_MILLISECONDS = 1500
BACKGROUND = (24, 24, 27)
INK = (228, 228, 231)


def contact_sheet(
    path: Path, folder: Path, rows: Mapping[str, Sequence[RunType]], target: Callable[[RunType], Any]
) -> None:
    """Draw the final image and the PSNR of every run, a row for each name; every row begins with its target."""
    columns = max(map(len, rows.values())) + 1
    first_target = target(next(iter(rows.values()))[0])
    height = round(CELL_WIDTH * first_target.shape[0] / first_target.shape[1])
    size = NAMES_WIDTH + columns * (CELL_WIDTH + GAP), len(rows) * (height + CAPTION_HEIGHT + GAP)
    sheet = Image.new("RGB", size, BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for line, (name, runs) in enumerate(rows.items()):
        top = line * (height + CAPTION_HEIGHT + GAP) + GAP
        draw.text((GAP, top + height // 3), textwrap.fill(name, MAX_LINE_LETTERS), fill=INK)
        target_picture = shown_as(target(runs[0]) if line else first_target)
        sheet.paste(target_picture.resize((CELL_WIDTH, height), Image.Resampling.BOX), (NAMES_WIDTH, top))
        draw.text((NAMES_WIDTH, top + height + 1), "target", fill=INK)
        for number, run in enumerate(runs, 1):
            record = load(folder, run)
            if record is None:
                continue
            left = NAMES_WIDTH + number * (CELL_WIDTH + GAP)
            with Image.open(picture_path(folder, run)) as picture:
                sheet.paste(picture.convert("RGB").resize((CELL_WIDTH, height), Image.Resampling.BOX), (left, top))
            draw.text((left, top + height + 1), f"{record['psnr']:.1f} dB", fill=INK)
    # A palette of 64 colours of this sheet keeps disks and their edges, in a third of the bytes.
    stream = io.BytesIO()
    sheet.quantize(64).save(stream, format="PNG", optimize=True)
    write_bytes(path, stream.getvalue())


def convergence_plot(
    path: Path, folder: Path, panels: Mapping[str, Mapping[str, Sequence[Run]]], curve_steps: int
) -> None:
    """Plot the mean squared error over the steps, a panel for each name and a line for each method.

    Each line is a geometric mean over seeds, with a point every `curve_steps` steps.
    """
    figure = new_figure(3.1 * len(panels), 3.2)
    panel_axes: Any = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (column, lines) in zip(panel_axes, panels.items(), strict=True):
        for name, runs in lines.items():
            curves = [record["curve"] for run in runs if (record := load(folder, run)) is not None]
            if curves:
                mean = np.mean(curves, axis=0)
                steps = curve_steps * np.arange(len(mean))
                axes.plot(steps, 10.0 ** (-mean / 10.0), label=name)
        axes.set(title=column, xlabel="step", yscale="log")
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panel_axes[0].set_ylabel("mean squared error")
    if panel_axes[-1].lines:
        panel_axes[-1].legend(frameon=False, fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    write_bytes(path, stream.getvalue())


def moments(path: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the parameters of a fit at up to `MAX_FRAMES` moments, including the first and the last."""
    count = len(next(iter(path.values())))
    chosen = np.unique(np.linspace(0, count - 1, min(MAX_FRAMES, count)).astype(int))
    return [{name: values[index] for name, values in path.items()} for index in chosen]


def animation(path: Path, images: Iterable[Any], target: Any) -> None:
    """Write an animated WebP of the display-referred images of a fit beside its target."""
    height = round(HALF_WIDTH * target.shape[0] / target.shape[1])
    frames = []
    for image in images:
        frame = Image.new("RGB", (2 * HALF_WIDTH + GAP, height), BACKGROUND)
        for index, half in enumerate((image, target)):
            resized = shown_as(half).resize((HALF_WIDTH, height), Image.Resampling.BICUBIC)
            frame.paste(resized, (index * (HALF_WIDTH + GAP), 0))
        frames.append(frame)
    stream = io.BytesIO()
    durations = [FRAME_MILLISECONDS] * (len(frames) - 1) + [LAST_FRAME_MILLISECONDS]
    frames[0].save(
        stream, "WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=70, method=4
    )
    write_bytes(path, stream.getvalue())


def shown_as(image: Any) -> Image.Image:
    """Return a display-referred image in [0, 1] as one of 8 bits."""
    return Image.fromarray(np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8))


def row_of(pictures: Mapping[str, Image.Image]) -> bytes:
    """Return a PNG of square pictures side by side, each above its name."""
    sheet = Image.new("RGB", (len(pictures) * (LARGE_SIDE + GAP) - GAP, LARGE_SIDE + 16), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for index, (name, picture) in enumerate(pictures.items()):
        left = index * (LARGE_SIDE + GAP)
        sheet.paste(picture.resize((LARGE_SIDE, LARGE_SIDE), Image.Resampling.NEAREST), (left, 0))
        draw.text((left + GAP, LARGE_SIDE + 2), name, fill=INK)
    stream = io.BytesIO()
    sheet.quantize(192).save(stream, format="PNG", optimize=True)
    return stream.getvalue()

"""The page of a sweep: ranked settings with pictures, every run, and failures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import ImageFileError
from loi_core.io.files import write_text
from loi_core.io.images import png_bytes, read_image
from loi_core.io.result_folder import PAGE_FILE
from loi_core.report.document import document
from loi_core.report.page import html_table
from loi_core.report.pictures import picture_figure
from loi_core.sweeps.leaderboard import Standing
from loi_core.sweeps.plan import Sweep, format_value
from loi_core.sweeps.table import CSV_FILE, DONE, FAILED, MISSING, Row

__all__ = ["LEADERBOARD_FILE", "write_leaderboard"]

LEADERBOARD_FILE: Final = "leaderboard.html"
MAX_SETTINGS: Final = 100  # with pictures
MAX_SIDE_PX: Final = 320  # of a picture
PICTURES: Final = {"target.png": "target", "final.png": "best run", "error.png": "|best run - target|"}
OMITTED_COLUMNS: Final = ("run", "objective", "psnr_initial", "best_step", "cause")
MEASURES: Final = {"psnr": "PSNR in dB", "value": "objective", "seconds": "seconds"}
MAX_CELL_LENGTH: Final = 60
MAX_HEADING_LENGTH: Final = 200


def write_leaderboard(sweep: Sweep, rows: Sequence[Row], standings: Sequence[Standing], runs: Path) -> Path:
    """Write ``leaderboard.html``, one self-contained page; `runs` is the folder of the run folders."""
    page = sweep.output / LEADERBOARD_FILE
    counts = Counter(row["status"] for row in rows)
    summary = ", ".join(f"{counts[status]} {status}" for status in (DONE, FAILED, MISSING) if counts[status])
    ranking = f"Ranked by {_measure(sweep.rank)}, the mean over seeds and starts."
    lead = f"{len(rows)} runs of {', '.join(sweep.scenes)}: {summary}. {ranking}"
    sections = [
        f"<h1>{escape(sweep.title)}</h1>",
        f'<p class="lead">{escape(lead)} <a href="{CSV_FILE}">All numbers</a></p>',
        *(_section(index, standing, sweep, runs) for index, standing in enumerate(standings[:MAX_SETTINGS], 1)),
        f"<h2>Every run</h2>{_table(rows, runs)}",
    ]
    failed = [row for row in rows if row["status"] == FAILED]
    if failed:
        items = "".join(f"<li><b>{escape(row['run'])}</b>: {escape(str(row['cause']))}</li>" for row in failed)
        sections.append(f"<h2>Failures</h2><ul>{items}</ul><p>`--retry-failed` runs these again.</p>")
    write_text(page, document(sweep.title, "\n".join(sections)))
    return page


def _measure(rank: str) -> str:
    return MEASURES.get(rank, rank.replace("error.", "the error of ", 1))


def _section(index: int, standing: Standing, sweep: Sweep, runs: Path) -> str:
    heading = f"<h2>{index}. {escape(_truncate(standing.name, MAX_HEADING_LENGTH))}</h2>"
    total = len(standing.rows)
    facts = [f"{standing.done} of {total} done"] if total > 1 or not standing.done else []
    facts += [f"{standing.failed} failed"] if standing.failed else []
    if standing.best is None:
        return f"{heading}<p>{', '.join(facts)}</p>"
    measure = f"{escape(_measure(sweep.rank))} <b>{_number(standing.mean)}</b>"
    if standing.done > 1:
        measure += f" (worst {_number(standing.worst)})"
    facts = [measure, f"{standing.converged} of {standing.done} converged", *facts]
    run = standing.best["run"]
    figures = "".join(_figure(runs / run / name, caption) for name, caption in PICTURES.items())
    return f'{heading}<p>{", ".join(facts)}; {_link(run, runs)}</p><div class="row">{figures}</div>'


def _link(run: str, runs: Path) -> str:
    """Return the name of a run, linked to its page if it has one."""
    if not (runs / run / PAGE_FILE).exists():
        return escape(run)
    return f'<a href="{escape(f"{runs.name}/{run}/{PAGE_FILE}")}">{escape(run)}</a>'


def _figure(path: Path, caption: str) -> str:
    """Return a picture of a run at reduced size; empty if the file cannot be read."""
    from PIL import Image

    try:
        image = read_image(path)
    except ImageFileError:
        return ""
    thumbnail = Image.fromarray(np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
    thumbnail.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
    return picture_figure(png_bytes(np.asarray(thumbnail) / 255.0), caption)


def _table(rows: Sequence[Row], runs: Path) -> str:
    names = [name for name in rows[0] if name not in OMITTED_COLUMNS]
    text_columns = [0] + [
        index for index, name in enumerate(names, 1) if not all(_is_number(row[name]) for row in rows)
    ]
    cells = [[_link(row["run"], runs), *(_cell(row[name]) for name in names)] for row in rows]
    return html_table("Every run", ["run", *names], cells, text_columns=text_columns)


def _cell(value: Any) -> str:
    if _is_number(value):
        return "" if value is None else _number(value)
    return escape(_truncate(format_value(value), MAX_CELL_LENGTH))


def _is_number(value: Any) -> bool:
    """Return whether a column of this value is aligned as numbers; a missing value does not decide it."""
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _truncate(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"


def _number(value: float) -> str:
    if math.isfinite(value) and value == round(value) and abs(value) < 1e15:
        return str(int(value))
    return f"{value:.4g}"

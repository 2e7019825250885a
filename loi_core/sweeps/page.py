"""The page of a sweep: who did best, with pictures, every run, and what failed."""

from __future__ import annotations

import base64
import io
import math
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import ImageFileError
from loi_core.io.files import write_text
from loi_core.io.images import read_image
from loi_core.io.result_folder import PAGE_FILE
from loi_core.report.document import document
from loi_core.sweeps.leaderboard import Standing
from loi_core.sweeps.plan import Sweep, spelled
from loi_core.sweeps.table import CSV_FILE, DONE, FAILED, MISSING, Row

__all__ = ["LEADERBOARD_FILE", "write_leaderboard"]

LEADERBOARD_FILE: Final = "leaderboard.html"
MOST_SHOWN: Final = 100  # settings with pictures
LONGEST_SIDE: Final = 320  # of a picture, pixels
PICTURES: Final = {"target.png": "target", "final.png": "best run", "error.png": "|best run - target|"}
LEFT_OUT: Final = ("run", "objective", "psnr_initial", "best_step", "cause")
NAMES: Final = {"psnr": "PSNR in dB", "value": "objective", "seconds": "seconds"}
LONGEST_CELL: Final = 60


def write_leaderboard(sweep: Sweep, rows: Sequence[Row], standings: Sequence[Standing], runs: Path) -> Path:
    """Write ``leaderboard.html``, one page with everything in it; the folders of the runs lie in `runs`."""
    page = sweep.output / LEADERBOARD_FILE
    counts = Counter(row["status"] for row in rows)
    told = ", ".join(f"{counts[kind]} {kind}" for kind in (DONE, FAILED, MISSING) if counts[kind])
    ranked = f"Ranked by {_name(sweep.rank)}, the mean over seeds and starts."
    lead = f"{len(rows)} runs of {', '.join(sweep.scenes)}: {told}. {ranked}"
    parts = [
        f"<h1>{escape(sweep.title)}</h1>",
        f'<p class="lead">{escape(lead)} <a href="{CSV_FILE}">All numbers</a></p>',
        *(_section(place, one, sweep, runs) for place, one in enumerate(standings[:MOST_SHOWN], 1)),
        f"<h2>Every run</h2>{_table(rows, runs)}",
    ]
    failed = [row for row in rows if row["status"] == FAILED]
    if failed:
        listed = "".join(f"<li><b>{escape(row['run'])}</b>: {escape(str(row['cause']))}</li>" for row in failed)
        parts.append(f"<h2>What failed</h2><ul>{listed}</ul><p>`--retry-failed` carries these out again.</p>")
    write_text(page, document(sweep.title, "\n".join(parts)))
    return page


def _name(rank: str) -> str:
    return NAMES.get(rank, rank.replace("error.", "the error of ", 1))


def _section(place: int, one: Standing, sweep: Sweep, runs: Path) -> str:
    head = f"<h2>{place}. {escape(_short(one.name, 200))}</h2>"
    total = len(one.rows)
    said = [f"{one.done} of {total} done"] if total > 1 or not one.done else []
    said += [f"{one.failed} failed"] if one.failed else []
    if one.best is None:
        return f"{head}<p>{', '.join(said)}</p>"
    measure = f"{escape(_name(sweep.rank))} <b>{_number(one.mean)}</b>"
    if one.done > 1:
        measure += f" (worst {_number(one.worst)})"
    said = [measure, f"{one.converged} of {one.done} converged", *said]
    folder = runs / one.best["run"]
    figures = "".join(_figure(folder / name, caption) for name, caption in PICTURES.items())
    return f'{head}<p>{", ".join(said)}; {_link(one.best["run"], runs)}</p><div class="row">{figures}</div>'


def _link(run: str, runs: Path) -> str:
    """The name of a run, and the way to its page if it has got as far as that."""
    if not (runs / run / PAGE_FILE).exists():
        return escape(run)
    return f'<a href="{escape(f"{runs.name}/{run}/{PAGE_FILE}")}">{escape(run)}</a>'


def _figure(path: Path, caption: str) -> str:
    """A picture of a run, made smaller if it is large; nothing if it cannot be read."""
    from PIL import Image

    try:
        image = read_image(path)
    except ImageFileError:
        return ""
    small = Image.fromarray(np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
    small.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    stream = io.BytesIO()
    small.save(stream, format="PNG", optimize=True)
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    shown = f'<img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
    return f"<figure>{shown}<figcaption>{escape(caption)}</figcaption></figure>"


def _table(rows: Sequence[Row], runs: Path) -> str:
    heads = [name for name in rows[0] if name not in LEFT_OUT]
    lines = []
    for row in rows:
        cells = "".join(_cell(row[name]) for name in heads)
        lines.append(f"<tr><td>{_link(row['run'], runs)}</td>{cells}</tr>")
    titles = "".join(f"<th>{escape(name)}</th>" for name in ("run", *heads))
    table = f"<table><tr>{titles}</tr>{''.join(lines)}</table>"
    return f'<div class="scroll" role="group" tabindex="0" aria-label="Every run">{table}</div>'


def _cell(value: Any) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f'<td class="n">{_number(value)}</td>'
    return f"<td>{escape('' if value is None else _short(spelled(value), LONGEST_CELL))}</td>"


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _number(value: float) -> str:
    if math.isfinite(value) and value == round(value) and abs(value) < 1e15:
        return str(int(value))
    return f"{value:.4g}"

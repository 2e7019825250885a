"""One self-contained HTML page for a result folder, or for several."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes, write_text
from loi_core.io.result_folder import MARKER_FILE, PAGE_FILE, RESULT_FILE
from loi_core.plugins.baselines import is_objective_name
from loi_core.report.curves import curves
from loi_core.report.document import REPORT, asset, document, is_made_by, scrollable
from loi_core.report.downloads import downloads
from loi_core.report.names import objective_label
from loi_core.report.pictures import Pictures
from loi_core.report.provenance import provenance
from loi_core.report.viewer import effects, gradients, viewer
from loi_core.support.values import formatted, real_number

__all__ = ["html_table", "run_page", "verdict_line", "write_index", "write_page"]

MAX_RESULT_BYTES: Final = 2**28  # of result.json
SAME_START: Final = "every objective from the same start with the same optimiser"


def write_page(folder: Path) -> Path:
    """Write ``report.html`` from the files of a result folder and return its path.

    Raises
    ------
    SceneError
        If the folder does not hold the results of a scene.
    """
    page, text = folder / PAGE_FILE, run_page(folder)  # a missing result is reported before a page in the way
    if page.exists() and not (folder / MARKER_FILE).exists():
        msg = f"{page} was not written by `loi`; move it away, and call again"
        raise SceneError(msg)
    write_text(page, text)
    return page


def run_page(folder: Path) -> str:
    """Return the page of a result folder as HTML.

    Raises
    ------
    SceneError
        If the folder does not hold the results of a scene.
    """
    result = _read(folder)
    return _page(result["title"], f"<main>{_section(folder, result, 0)}</main>")


def write_index(page: Path, folders: Sequence[Path], title: str) -> Path:
    """Write one page of several result folders and return its path.

    Raises
    ------
    SceneError
        If a folder does not hold the results of a scene, or the file at `page` is not a report.
    """
    if page.exists() and not is_made_by(page, REPORT):
        msg = f"{page} was not written by `loi`; move it away, or name another file"
        raise SceneError(msg)
    results = [_read(folder) for folder in folders]
    sections = [
        _section(folder, result, run, level=2)
        for run, (folder, result) in enumerate(zip(folders, results, strict=True))
    ]
    head = f"<header><h1>{escape(title)}</h1>{_contents(results)}</header>"
    write_text(page, _page(title, f"{head}<main>{''.join(sections)}</main>"))
    return page


def verdict_line(trial: Mapping[str, Any]) -> str:
    """Return the diagnosis in the summary of a fit as one line; empty without a diagnosis."""
    diagnosis = trial.get("diagnosis")
    if not isinstance(diagnosis, Mapping):
        return ""
    texts = [str(diagnosis[key]) for key in ("verdict", "message") if diagnosis.get(key)]
    advice = str(diagnosis.get("advice") or "")
    return ": ".join(texts) + (f"; {advice}" if advice else "")


def html_table(label: str, heads: Sequence[str], rows: Sequence[Sequence[str]], *, text_columns: Sequence[int]) -> str:
    """Return a table that scrolls sideways.

    Parameters
    ----------
    label : str
        The name of the table.
    heads : sequence of str
        The names of the columns, as text.
    rows : sequence of sequence of str
        The cells, as HTML.
    text_columns : sequence of int
        The columns that do not hold numbers.
    """
    attributes = ["" if column in text_columns else ' class="n"' for column in range(len(heads))]
    titles = "".join(
        f'<th scope="col"{attribute}>{escape(head)}</th>' for head, attribute in zip(heads, attributes, strict=True)
    )
    lines = "".join(
        f"<tr>{''.join(f'<td{attribute}>{cell}</td>' for cell, attribute in zip(row, attributes, strict=True))}</tr>"
        for row in rows
    )
    return scrollable(label, f"<table><thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table>")


def _page(title: str, body: str) -> str:
    return document(title, body, style=asset("report.css"), script=asset("report.js"))


def _contents(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of contents of a page of several runs."""
    heads = ("run", "objective", "PSNR at the start, dB", "at the end, dB", "outcome")
    rows = []
    for run, result in enumerate(results):
        trial = result["trials"][0]
        link = f'<a href="#run-{run}">{escape(result["title"])}</a>'
        first, last = (formatted(trial.get(key), ".2f") for key in ("psnr_initial", "psnr"))
        rows.append([link, _label(trial), first, last, escape(_outcome(trial))])
    return html_table("Runs", heads, rows, text_columns=(0, 1, 4))


def _read(folder: Path) -> dict[str, Any]:
    """Return ``result.json`` of a folder, checked, and without the path of the folder: pages are shown to others."""
    path = folder / RESULT_FILE
    try:
        result = json.loads(read_bytes(path, MAX_RESULT_BYTES))
    except FileNotFoundError:
        msg = f"{folder}: no {RESULT_FILE} there; give a folder that `loi fit` has written"
        raise SceneError(msg) from None
    except (OSError, ValueError, RecursionError):
        result = None
    if not _is_result(result):
        msg = f"{path}: not the result of `loi fit`"
        raise SceneError(msg)
    output = result.get("output")
    if isinstance(output, str):
        result["output"] = Path(output).name
        directory = output.rstrip("/\\")
        for trial in result["trials"]:
            if len(directory) > 1 and isinstance(trial.get("error"), str):
                trial["error"] = trial["error"].replace(directory, Path(output).name)
    return dict(result)


def _is_result(result: Any) -> bool:
    """Return whether a value from JSON has all entries that a page needs, of the right types."""
    if not isinstance(result, dict) or not all(isinstance(result.get(key), str) for key in ("title", "scene")):
        return False
    trials = result.get("trials")
    return (
        isinstance(result.get("steps"), int)
        and isinstance(trials, list)
        and bool(trials)
        and all(map(_is_trial, trials))
    )


def _is_trial(trial: Any) -> bool:
    if not isinstance(trial, dict) or not is_objective_name(trial.get("objective")):
        return False
    errors = trial.get("parameter_errors", {})
    return isinstance(trial.get("error"), str | None) and isinstance(errors, dict)


def _section(folder: Path, result: Mapping[str, Any], run: int, level: int = 1) -> str:
    """Return a run as a section with a title of this level."""
    pictures = Pictures(folder)
    trials = result["trials"]
    lead = f"{result['scene']}, {int(result['steps'])} steps" + (f"; {SAME_START}" if len(trials) > 1 else "")
    return "\n".join(
        [
            f'<section class="run" id="run-{run}">',
            f'<h{level} class="title">{escape(result["title"])}</h{level}>',
            f'<p class="lead">{escape(lead)}</p>',
            *_notes(result),
            _verdict(trials[0]),
            viewer(pictures, folder, trials, run),
            f"<h2>Numbers</h2>{_numbers(trials)}",
            *curves(pictures, result),
            *gradients(pictures, result),
            *effects(pictures, result),
            provenance(result),
            downloads(pictures, folder, result),
            "</section>",
        ]
    )


def _notes(result: Mapping[str, Any]) -> list[str]:
    """Return the names of the views and the notes on targets and pictures as one paragraph."""
    notes, views = result.get("notes"), result.get("views")
    lines = [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else []
    if isinstance(views, list) and views and all(isinstance(name, str) for name in views):
        lines.insert(0, f"views, from left to right: {', '.join(views)}")
    return [f'<p class="lead">{"<br>".join(map(escape, lines))}</p>'] if lines else []


def _verdict(trial: Mapping[str, Any]) -> str:
    """Return the outcome of the first fit as a highlighted line."""
    first, last = real_number(trial.get("psnr_initial")), real_number(trial.get("psnr"))
    quality = f"PSNR from {first:.1f} to {last:.1f} dB; " if math.isfinite(first) and math.isfinite(last) else ""
    text = quality + _outcome(trial)
    if not text:
        return ""
    diagnosis = trial.get("diagnosis")
    converged = isinstance(diagnosis, Mapping) and diagnosis.get("verdict") == "converged" and not trial.get("error")
    return f'<p class="verdict {"good" if converged else "open"}"><b>{_label(trial)}</b> {escape(text)}</p>'


def _outcome(trial: Mapping[str, Any]) -> str:
    return trial.get("error") or verdict_line(trial)


def _label(trial: Mapping[str, Any]) -> str:
    return escape(objective_label(trial["objective"]))


def _numbers(trials: Sequence[Mapping[str, Any]]) -> str:
    names = sorted({name for trial in trials for name in trial.get("parameter_errors", {})})
    heads = ["objective", "PSNR, dB", "best step", "seconds", *(f"error of {name}" for name in names), "verdict"]
    rows = []
    for trial in trials:
        errors = trial.get("parameter_errors", {})
        numbers = [
            formatted(trial.get(key), spec) for key, spec in (("psnr", ".2f"), ("best_step", ".0f"), ("seconds", ".1f"))
        ]
        numbers += [formatted(errors.get(name), ".4g") for name in names]
        rows.append([_label(trial), *numbers, escape(_outcome(trial))])
    return html_table("Numbers of every objective", heads, rows, text_columns=(0, len(heads) - 1))

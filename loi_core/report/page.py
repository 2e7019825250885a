"""One self-contained HTML page for a result folder, and one for several."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes, write_text
from loi_core.io.result_folder import PAGE_FILE, RESULT_FILE, is_listed
from loi_core.plugins.baselines import is_objective_name
from loi_core.report.curves import curves
from loi_core.report.document import REPORT, document, is_made_by
from loi_core.report.downloads import downloads
from loi_core.report.kept import Pictures
from loi_core.report.making import making
from loi_core.report.plots import LABELS
from loi_core.report.theme import asset
from loi_core.report.viewer import effects, gradients, viewer
from loi_core.support.values import real_number

__all__ = ["Pictures", "document", "run_page", "verdict_line", "write_index", "write_page"]

MOST_RESULT: Final = 2**28  # bytes of result.json
SAME_START: Final = "every objective from the same start with the same optimiser"


def write_page(folder: Path) -> Path:
    """Make ``report.html`` from what a result folder holds; returns its path.

    Raises
    ------
    SceneError
        If the folder does not hold the results of a scene.
    """
    page, text = folder / PAGE_FILE, run_page(folder)  # first, since what is not there comes before what is in its way
    if page.exists() and not is_listed(page):
        msg = f"{page} was not written by `loi`; move it away, and call again"
        raise SceneError(msg)
    write_text(page, text)
    return page


def run_page(folder: Path) -> str:
    """The page of a result folder. Errors as in :func:`write_page`."""
    result = _read(folder)
    return _page(result["title"], f"<main>{_section(folder, result, 0)}</main>")


def write_index(page: Path, folders: Sequence[Path], title: str) -> Path:
    """Make one page of several result folders; returns its path.

    Raises
    ------
    SceneError
        If a folder does not hold the results of a scene, or there is a file at `page` that no report is.
    """
    if page.exists() and not is_made_by(page, REPORT):
        msg = f"{page} was not written by `loi`; move it away, or name another file"
        raise SceneError(msg)
    results = [_read(folder) for folder in folders]
    sections = [_section(folder, one, run, 2) for run, (folder, one) in enumerate(zip(folders, results, strict=True))]
    head = f"<header><h1>{escape(title)}</h1>{_contents(results)}</header>"
    write_text(page, _page(title, f"{head}<main>{''.join(sections)}</main>"))
    return page


def _page(title: str, body: str) -> str:
    return document(title, body, style=asset("report.css"), script=asset("report.js"))


def _contents(results: Sequence[Mapping[str, Any]]) -> str:
    """Where each run stands on a page of several."""
    rows = []
    for run, result in enumerate(results):
        trial = result["trials"][0]
        start, end = (_number(trial.get(key), ".2f") for key in ("psnr_initial", "psnr"))
        rows.append(
            f'<tr><th scope="row"><a href="#run-{run}">{escape(result["title"])}</a></th><td>{_name(trial)}</td>'
            f'<td class="n">{start}</td><td class="n">{end}</td><td>{escape(_came(trial))}</td></tr>'
        )
    heads = '<th scope="col">run</th><th scope="col">objective</th><th scope="col" class="n">PSNR at the start, dB</th>'
    heads += '<th scope="col" class="n">at the end, dB</th><th scope="col">what came of it</th>'
    return _scrolled("Runs", f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>")


def _scrolled(name: str, table: str) -> str:
    return f'<div class="scroll" role="group" tabindex="0" aria-label="{escape(name)}">{table}</div>'


def _read(folder: Path) -> dict[str, Any]:
    path = folder / RESULT_FILE
    try:
        result = json.loads(read_bytes(path, MOST_RESULT))
    except FileNotFoundError:
        msg = f"{folder}: no {RESULT_FILE} there; give a folder that `loi fit` has written"
        raise SceneError(msg) from None
    except (OSError, ValueError, RecursionError):
        result = None
    if not _is_result(result):
        msg = f"{path}: not the result of `loi fit`"
        raise SceneError(msg)
    return _without_paths(dict(result))


def _without_paths(result: dict[str, Any]) -> dict[str, Any]:
    """The same, without the place of the folder: a page is shown to others."""
    place = result.get("output")
    if not isinstance(place, str):
        return result
    result["output"] = Path(place).name
    folder = place.rstrip("/\\")
    if len(folder) > 1:
        for trial in result["trials"]:
            if isinstance(trial.get("error"), str):
                trial["error"] = trial["error"].replace(folder, Path(place).name)
    return result


def _is_result(result: Any) -> bool:
    """Whether this has all that a page shows, of the right types."""
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
    """A run; on a page of several, its title is of the second level."""
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
            f"<h2>Numbers</h2>{_table(trials)}",
            *curves(pictures, result),
            *gradients(pictures, result),
            *effects(pictures, result),
            making(result),
            downloads(pictures, folder, result),
            "</section>",
        ]
    )


def _notes(result: Mapping[str, Any]) -> list[str]:
    """What was done to the targets and to the pictures, and which views they show."""
    notes, views = result.get("notes"), result.get("views")
    lines = [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else []
    if isinstance(views, list) and views and all(isinstance(name, str) for name in views):
        lines.insert(0, f"views, from left to right: {', '.join(views)}")
    return [f'<p class="lead">{"<br>".join(map(escape, lines))}</p>'] if lines else []


def _verdict(trial: Mapping[str, Any]) -> str:
    """What came of the first fit, in a line that stands out."""
    start, end = real_number(trial.get("psnr_initial")), real_number(trial.get("psnr"))
    told = f"PSNR from {start:.1f} to {end:.1f} dB; " if math.isfinite(start) and math.isfinite(end) else ""
    line = _came(trial)
    if not told and not line:
        return ""
    found = trial.get("diagnosis")
    good = isinstance(found, Mapping) and found.get("verdict") == "converged" and not trial.get("error")
    mark = "good" if good else "open"
    return f'<p class="verdict {mark}"><b>{_name(trial)}</b> {escape(told)}{escape(line)}</p>'


def _came(trial: Mapping[str, Any]) -> str:
    return trial.get("error") or verdict_line(trial)


def _name(trial: Mapping[str, Any]) -> str:
    return escape(LABELS.get(trial["objective"], trial["objective"]))


def _table(trials: Sequence[Mapping[str, Any]]) -> str:
    names = sorted({name for trial in trials for name in trial.get("parameter_errors", {})})
    heads = ["objective", "PSNR, dB", "best step", "seconds", *(f"error of {name}" for name in names), "verdict"]
    rows = []
    for trial in trials:
        errors = trial.get("parameter_errors", {})
        cells = [
            _number(trial.get("psnr"), ".2f"),
            _number(trial.get("best_step"), ".0f"),
            _number(trial.get("seconds"), ".1f"),
            *(_number(errors.get(name), ".4g") for name in names),
        ]
        numbers = "".join(f'<td class="n">{cell}</td>' for cell in cells)
        rows.append(f"<tr><td>{_name(trial)}</td>{numbers}<td>{escape(_came(trial))}</td></tr>")
    titles = "".join(
        f'<th scope="col"{"" if index in (0, len(heads) - 1) else " class=n"}>{escape(head)}</th>'
        for index, head in enumerate(heads)
    )
    table = f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return _scrolled("Numbers of every objective", table)


def verdict_line(trial: Mapping[str, Any]) -> str:
    """What came of a fit, as the summary of its results has it, whoever wrote that; empty if it does not say."""
    found = trial.get("diagnosis")
    if not isinstance(found, Mapping):
        return ""
    parts = [str(found[key]) for key in ("verdict", "message") if found.get(key)]
    advice = str(found.get("advice") or "")
    return ": ".join(parts) + (f"; {advice}" if advice else "")


def _number(value: Any, spec: str) -> str:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "-"
    return format(real_number(value), spec)

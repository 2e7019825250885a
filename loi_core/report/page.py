"""One self-contained HTML page for a result folder, and one for several."""

from __future__ import annotations

import base64
import json
import re
import stat
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.errors import SceneError
from loi_core.io.files import read_bytes, write_text
from loi_core.io.result_folder import FRAME_NAME, PAGE_FILE, RESULT_FILE, is_listed
from loi_core.plugins.baselines import is_objective_name
from loi_core.report.output import FRAMES_FOLDER, effect_file
from loi_core.report.plots import LABELS
from loi_core.support.values import real_number

__all__ = ["Pictures", "document", "verdict_line", "write_index", "write_page"]

MOST_RESULT: Final = 2**28  # bytes of result.json
MOST_PICTURE: Final = 2**26  # bytes of one PNG
MOST_PICTURES: Final = 2**28  # and of all on a page
MOST_FRAMES: Final = 1000
PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
EFFECT_NAME: Final = re.compile(r"[\w -]{1,80}")
SAME_START: Final = "every objective from the same start with the same optimiser"
STYLE: Final = """
:root { color-scheme: light dark; --line: #8884; --soft: #8882; --accent: #c2410c; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 64rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
p.lead { margin-top: 0; opacity: .8; }
.row { display: flex; flex-wrap: wrap; gap: .8rem; } figure { margin: 0; }
figcaption { font-size: .85rem; opacity: .8; }
.row img { width: 14.5rem; image-rendering: pixelated; border: 1px solid var(--line); background: #000; }
.film img { width: 7rem; } img.plot { max-width: 100%; background: #fff; border-radius: .3rem; }
.ours figcaption { color: var(--accent); font-weight: 600; opacity: 1; }
table { border-collapse: collapse; } th, td { padding: .3rem .8rem; border-bottom: 1px solid var(--line); }
th { text-align: left; background: var(--soft); } td.n { text-align: right; font-variant-numeric: tabular-nums; }
"""


def write_page(folder: Path) -> Path:
    """Make ``report.html`` from what a result folder holds; returns its path.

    Raises
    ------
    SceneError
        If the folder does not hold the results of a scene.
    """
    page = folder / PAGE_FILE
    if page.exists() and not is_listed(page):
        msg = f"{page} was not written by `loi`; move it away, and call again"
        raise SceneError(msg)
    write_text(page, document(_read(folder)["title"], _section(folder, Pictures(folder))))
    return page


def write_index(page: Path, folders: Sequence[Path], title: str) -> Path:
    """Make one page of several result folders; returns its path. Errors as in :func:`write_page`."""
    write_text(page, document(title, "\n".join(_section(folder, Pictures(folder)) for folder in folders)))
    return page


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
    return dict(result)


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


def document(title: str, body: str) -> str:
    """A whole HTML page around `body`."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>\n'
        f"<body>\n{body}\n</body></html>\n"
    )


def _section(folder: Path, pictures: Pictures) -> str:
    result = _read(folder)
    trials = result["trials"]
    first = trials[0]["objective"] if trials else ""
    start = [pictures.figure("initial.png", "start"), pictures.figure("target.png", "target")]
    finals, errors = [], []
    for index, trial in enumerate(trials):
        own = "" if index == 0 else f"compare/{trial['objective']}/"
        label = LABELS.get(trial["objective"], trial["objective"])
        ours = ' class="ours"' if index == 0 else ""
        finals.append(pictures.figure(f"{own}final.png", label, ours))
        errors.append(pictures.figure(f"{own}error.png", f"{label}: |final - target|", ours))
    film = [pictures.figure(name, f"step {step}") for step, name in _frames(folder).items()]
    plot = pictures.figure("convergence.png", "", image_class="plot")
    return "\n".join(
        [
            f"<h1>{escape(result['title'])}</h1>",
            f'<p class="lead">{escape(result["scene"])}, {int(result["steps"])} steps; {SAME_START}</p>',
            *_notes(result),
            f'<div class="row">{"".join(start)}</div>',
            f'<h2>Where each objective ended</h2><div class="row">{"".join(finals)}</div>',
            f'<div class="row">{"".join(errors)}</div>',
            f"<h2>Numbers</h2>{_table(trials)}",
            f"<h2>Convergence</h2>{plot}",
            f'<h2>The way of {escape(LABELS.get(first, first))}</h2><div class="row film">{"".join(film)}</div>',
            *_effects(pictures, result),
        ]
    )


def _notes(result: Mapping[str, Any]) -> list[str]:
    """What was done to the targets and to the pictures, and which views they show."""
    notes, views = result.get("notes"), result.get("views")
    lines = [note for note in notes if isinstance(note, str)] if isinstance(notes, list) else []
    if isinstance(views, list) and views and all(isinstance(name, str) for name in views):
        lines.insert(0, f"views, from left to right: {', '.join(views)}")
    return [f'<p class="lead">{"<br>".join(map(escape, lines))}</p>'] if lines else []


def _frames(folder: Path) -> dict[int, str]:
    """The pictures of the way, by step."""
    names = sorted(path.name for path in (folder / FRAMES_FOLDER).glob("*.png") if FRAME_NAME.fullmatch(path.name))
    return {int(Path(name).stem): f"{FRAMES_FOLDER}/{name}" for name in names[:MOST_FRAMES]}


def _effects(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """What each effect changes in the image at the start, and the plan; nothing if the renderer plans nothing."""
    plan, effects = result.get("plan"), result.get("effects")
    if not isinstance(plan, str) or not isinstance(effects, Mapping):
        return []
    shown = [
        pictures.figure(effect_file(name), f"{name}: {'on' if on else 'off'}")
        for name, on in effects.items()
        if EFFECT_NAME.fullmatch(name)
    ]
    row = f'<div class="row">{"".join(shown)}</div>'
    return [f"<h2>Effects: how each changes the image along the first descent</h2>{row}<pre>{escape(plan)}</pre>"]


class Pictures:
    """The PNGs of a result folder, put into a page; what lies elsewhere, or is no PNG, is not.

    Parameters
    ----------
    folder : Path
        The folder of results.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._left = MOST_PICTURES

    def figure(self, name: str, caption: str, attributes: str = "", *, image_class: str = "") -> str:
        """A PNG with a caption; nothing if there is no such file, or it is not a PNG.

        Raises
        ------
        SceneError
            If it is a link, or too large.
        """
        png = self._read(name)
        if png is None:
            return ""
        data = base64.b64encode(png).decode("ascii")
        kind = f' class="{image_class}"' if image_class else ""
        image = f'<img{kind} alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        return f"<figure{attributes}>{image}<figcaption>{escape(caption)}</figcaption></figure>"

    def _read(self, name: str) -> bytes | None:
        path, mode = self._folder, 0
        for part in Path(name).parts:
            path = path / part
            try:
                mode = path.lstat().st_mode
            except (FileNotFoundError, NotADirectoryError):
                return None
            if stat.S_ISLNK(mode):
                raise self._refused(path, "is a link, and may lead anywhere")
        if not stat.S_ISREG(mode):
            return None
        if path.lstat().st_size > min(MOST_PICTURE, self._left):
            raise self._refused(path, "is too large for a page")
        content = read_bytes(path, MOST_PICTURE)
        self._left -= len(content)
        return content if content.startswith(PNG_SIGNATURE) else None

    @staticmethod
    def _refused(path: Path, why: str) -> SceneError:
        return SceneError(f"{path} {why}; a report shows the pictures of its own folder")


def _table(trials: Sequence[Mapping[str, Any]]) -> str:
    names = sorted({name for trial in trials for name in trial.get("parameter_errors", {})})
    heads = ["objective", "PSNR, dB", "best step", "seconds", *(f"error of {name}" for name in names), ""]
    rows = []
    for trial in trials:
        errors = trial.get("parameter_errors", {})
        cells = [
            _number(trial.get("psnr"), ".2f"),
            _number(trial.get("best_step"), ".0f"),
            _number(trial.get("seconds"), ".1f"),
            *(_number(errors.get(name), ".4g") for name in names),
        ]
        label = escape(LABELS.get(trial["objective"], trial["objective"]))
        numbers = "".join(f'<td class="n">{cell}</td>' for cell in cells)
        rows.append(f"<tr><td>{label}</td>{numbers}<td>{escape(trial.get('error') or verdict_line(trial))}</td></tr>")
    return f"<table><tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr>{''.join(rows)}</table>"


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

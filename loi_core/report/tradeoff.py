"""What ``loi tradeoff`` has measured: as lines, as plain values, and as files."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any, Final

from loi_core.io.files import write_bytes, write_text
from loi_core.io.images import write_png
from loi_core.report.page import Pictures, document
from loi_core.report.plots import tradeoff_plot
from loi_core.support.markdown import markdown
from loi_core.support.processors import usable_processors
from loi_core.tradeoff import HIDDEN, Noise, Row, Tradeoff

__all__ = ["RESULT_FILE", "plain", "tradeoff_lines", "write_tradeoff"]

RESULT_FILE: Final = "tradeoff.json"
TEXTS: Final = 4  # columns of the main table that are not numbers
BUSY: Final = 0.5  # load for each core beyond which times are not to be trusted
ODD: Final = 1e-2  # error of "exact" that more than rounding must have caused: float32's tails


def write_tradeoff(folder: Path, found: Tradeoff) -> dict[str, Any]:
    """Write ``tradeoff.json``, ``tradeoff.png``, both images and ``report.html``; return what the first holds."""
    answer = plain(found)
    page = folder / "report.html"
    write_png(folder / "image.png", found.problem.image)
    write_png(folder / "reference.png", found.problem.reference)
    write_bytes(folder / "tradeoff.png", tradeoff_plot(found))
    write_text(folder / RESULT_FILE, json.dumps(answer, indent=2, allow_nan=False) + "\n")
    write_text(page, document(f"loi tradeoff: {found.problem.name}", _body(folder, found)))
    return answer | {"report": str(page)}


def plain(found: Tradeoff) -> dict[str, Any]:
    """All numbers, as plain values for JSON; those that were not measured are null."""
    problem = found.problem
    advice = found.recommendation
    return {
        "problem": {
            "name": problem.name,
            "height": problem.image.shape[0],
            "width": problem.image.shape[1],
            "channels": problem.image.shape[2],
            "scales": asdict(problem.scales),
        },
        "machine": machine(),
        "load": found.load,
        "rows": [_row(row, pareto=mark) for row, mark in zip(found.rows, found.pareto, strict=True)],
        "missing": [asdict(one) for one in found.missing],
        "stochastic": found.stochastic,
        "noises": [asdict(one) | {"least": one.least} for one in found.noises],
        "recommendation": None
        if advice is None
        else asdict(advice[1]) | {"index": found.rows.index(advice[0]), "sentence": _advice(found)},
        "interrupted": found.interrupted,
    }


def machine() -> str:
    """The machine in words: what times depend on, as far as Python knows."""
    return (
        f"{usable_processors()} cores of {platform.machine()}, {platform.system()}, Python {platform.python_version()}"
    )


def tradeoff_lines(found: Tradeoff) -> list[str]:
    """The tables and the recommendation, as lines for a terminal; the tables are also Markdown."""
    lines = [_title(found), ""]
    if found.rows:
        lines += [*markdown(_heads(found), _cells(found)), "", *_notes(found)]
    if found.noises:
        lines += ["", *markdown(*_noise_table(found.noises)), "", _noise_note(found)]
    lines += [f"{row.setting} was not measured: {row.problem}" for row in found.rows if row.problem]
    lines += [_missing(one.name, one.problem, one.fix) for one in found.missing]
    advice = _advice(found)
    return [*lines, "", f"Recommended: {advice}"] if advice else lines


def _row(row: Row, *, pareto: bool) -> dict[str, Any]:
    scales = row.setting.scales
    return {
        "backend": row.setting.backend,
        "device": row.device or None,
        "accuracy": row.setting.accuracy,
        "dtype": row.setting.dtype,
        "change": row.setting.change or None,
        "sigma": scales.sigma,
        "alpha": scales.alpha,
        "beta": scales.beta,
        "levels": row.setting.levels,
        "seconds": _finite(row.seconds),
        "runs": row.runs,
        "memory_bytes": row.memory,
        "error": _finite(row.error),
        "parameter_error": row.parameter_error,
        "pareto": pareto,
        "problem": row.problem or None,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _title(found: Tradeoff) -> str:
    height, width, channels = found.problem.image.shape
    scales = found.problem.scales
    listed = ", ".join(
        f"{name} {' '.join(f'{value:g}' for value in getattr(scales, name))}" for name in ("sigma", "alpha", "beta")
    )
    return f"{found.problem.name}: {height}x{width}x{channels}; {listed}; {machine()}"


def _heads(found: Tradeoff) -> list[str]:
    heads = ["backend", "accuracy", "dtype", "scales", "levels", "ms", "MiB", "error"]
    return [*heads, *(["of parameters"] if _has_parameters(found) else []), "Pareto"]


def _has_parameters(found: Tradeoff) -> bool:
    return any(row.parameter_error is not None for row in found.rows)


def _cells(found: Tradeoff) -> list[list[str]]:
    table = []
    for row, mark in zip(found.rows, found.pareto, strict=True):
        setting = row.setting
        device = f" ({row.device})" if row.device not in ("", "cpu") else ""
        cells = [setting.backend + device, setting.accuracy, setting.dtype, setting.change or "all"]
        cells += [str(setting.levels), _shown(1e3 * row.seconds, ".4g")]
        cells += [_shown(None if row.memory is None else row.memory / 2**20, ".1f"), _shown(row.error, ".1e")]
        if _has_parameters(found):
            cells.append(_shown(row.parameter_error, ".1e"))
        table.append([*cells, "*" if mark else ""])
    return table


def _noise_table(noises: Sequence[Noise]) -> tuple[list[str], list[list[str]]]:
    names = list(dict.fromkeys(name for noise in noises for name in noise.parameters))
    heads = ["samples per pixel", "ms", "seeds", *(f"noise of {name}" for name in names)]
    return heads, [
        [
            "-" if one.samples is None else str(one.samples),
            _shown(1e3 * one.seconds, ".4g"),
            str(one.seeds),
            *(_shown(one.parameters.get(name), ".2g") for name in names),
        ]
        for one in noises
    ]


def _shown(value: float | None, spec: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, spec)


def _notes(found: Tradeoff) -> list[str]:
    lines = [
        "ms: median of value and gradient. MiB: growth of the process's peak memory. error: of the image's gradient,",
        "relative, against exact in float64 on NumPy with all scales; other scales are another loss.",
    ]
    if _has_parameters(found):
        lines.append("of parameters: the same of the gradient of the parameter where it is largest; it is what counts.")
    elif any(row.setting.accuracy == "exact" and not row.setting.change and row.error > ODD for row in found.rows):
        lines.append(
            "Large errors of float32: far from all that differs, it has no gradient where float64 still has one."
        )
        lines.append(
            "Parameters seldom feel those pixels; measure a scene, with --scene, to see what its parameters feel."
        )
    lines.append("*: in the Pareto set, nothing is both faster and as accurate.")
    if found.load is not None and found.load > BUSY * usable_processors():
        lines.append(f"The machine was busy when this began, with a load of {found.load:.1f}: times are too long.")
    if found.interrupted:
        lines.append("Interrupted: the table is not complete.")
    return lines


def _noise_note(found: Tradeoff) -> str:
    said = "Noise of the parameters' gradient from one seed, relative. ms: one render with its pullback."
    return said if found.noise is not None else f"{said} The scene's own count was not reached."


def _missing(name: str, problem: str, fix: str) -> str:
    return f"{name} was not measured: {problem}" + (f"; {fix}" if fix else "")


def _advice(found: Tradeoff) -> str:
    """The recommendation in words; empty if there is none."""
    if found.recommendation is None:
        return ""
    row, advice = found.recommendation
    what = f"{row.setting}, {1e3 * row.seconds:.4g} ms"
    error = f"{advice.error:.1e}"
    if row.parameter_error is not None:
        error += " in the parameters' gradient"
    if advice.noise is not None:
        own = None if found.noise is None else found.noise.samples
        noise = f"the renderer's own noise{'' if own is None else f' at {own} samples'}, {advice.noise:.1e}"
        if advice.met:
            return f"{what}. Its error, {error}, is less than {HIDDEN:.0%} of {noise}, and hides under it."
        return f"{what}, the most accurate. Its error, {error}, does not hide under {noise}."
    bound = f"what balanced promises, {advice.allowed:g}"
    if not advice.met:
        return f"{what}, the most accurate. No error is within {bound}; its own is {error}."
    why = (
        "nothing is random here" if found.stochastic is False else "without a renderer there is no noise to hide under"
    )
    return f"{what}. It is the cheapest with an error, {error}, within {bound}; {why}."


def _body(folder: Path, found: Tradeoff) -> str:
    pictures = Pictures(folder)
    images = [pictures.figure(f"{name}.png", name) for name in ("image", "reference")]
    parts = [
        f"<h1>{escape(found.problem.name)}: what accuracy costs</h1>",
        f'<p class="lead">{escape(_title(found))}</p>',
        f"<p><b>{escape(_advice(found))}</b></p>",
        f'<div class="row">{"".join(images)}</div>',
        f"<h2>Error and time</h2>{pictures.figure('tradeoff.png', '', image_class='plot')}",
        f"<h2>Every setting</h2>{_html(_heads(found), _cells(found), TEXTS)}<p>{escape(' '.join(_notes(found)))}</p>",
    ]
    if found.noises:
        parts.append(f"<h2>The renderer</h2>{_html(*_noise_table(found.noises), 0)}<p>{escape(_noise_note(found))}</p>")
    parts += [f"<p>{escape(_missing(one.name, one.problem, one.fix))}</p>" for one in found.missing]
    return "\n".join(parts)


def _html(heads: Sequence[str], rows: Iterable[Sequence[str]], texts: int) -> str:
    lines = ["".join(f"<th>{escape(head)}</th>" for head in heads)]
    for row in rows:
        words = "".join(f"<td>{escape(cell)}</td>" for cell in row[:texts])
        lines.append(words + "".join(f'<td class="n">{escape(cell)}</td>' for cell in row[texts:]))
    table = f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"
    return f'<div class="scroll" role="group" tabindex="0" aria-label="{escape(heads[0])}">{table}</div>'

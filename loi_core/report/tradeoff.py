"""The measurements of ``loi tradeoff`` as lines, as plain values, as a chart and as a page."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any, Final, Literal

from loi_core.io.files import write_text
from loi_core.io.images import png_bytes, write_png
from loi_core.report.curves import chart_figure
from loi_core.report.document import asset, document
from loi_core.report.page import html_table
from loi_core.report.pictures import picture_figure
from loi_core.support.charts import Chart, Line
from loi_core.support.markdown import markdown
from loi_core.support.processors import usable_processors
from loi_core.support.values import finite_or_none, formatted
from loi_core.tradeoff import MAX_NOISE_FRACTION, Noise, Row, Tradeoff

__all__ = ["RESULT_FILE", "plain", "tradeoff_lines", "write_tradeoff"]

RESULT_FILE: Final = "tradeoff.json"
TEXT_COLUMNS: Final = 4  # columns of the main table, from the left, that do not hold numbers
MAX_LOAD_PER_CORE: Final = 0.5  # with a larger load, times are not to be trusted
MAX_EXACT_ERROR: Final = 1e-2  # a larger error of "exact" comes from float32's tails
MIN_PLOTTED_ERROR: Final = 1e-16
PARETO_COLOUR: Final = 0
NOISE_COLOUR: Final = 1
FIRST_BACKEND_COLOUR: Final = 2


def write_tradeoff(folder: Path, result: Tradeoff) -> dict[str, Any]:
    """Write ``tradeoff.json``, both images and ``report.html`` with the chart; return the content of the first."""
    answer = plain(result)
    page = folder / "report.html"
    write_png(folder / "image.png", result.problem.image)
    write_png(folder / "reference.png", result.problem.reference)
    write_text(folder / RESULT_FILE, json.dumps(answer, indent=2, allow_nan=False) + "\n")
    write_text(page, document(f"loi tradeoff: {result.problem.name}", _body(result), style=asset("report.css")))
    return answer | {"report": str(page)}


def plain(result: Tradeoff) -> dict[str, Any]:
    """Return all numbers as plain values for JSON; null where nothing was measured."""
    problem = result.problem
    advice = result.recommendation
    return {
        "problem": {
            "name": problem.name,
            "height": problem.image.shape[0],
            "width": problem.image.shape[1],
            "channels": problem.image.shape[2],
            "scales": asdict(problem.scales),
        },
        "machine": machine(),
        "load": result.load,
        "rows": [_row(row, pareto=mark) for row, mark in zip(result.rows, result.pareto, strict=True)],
        "missing": [asdict(backend) for backend in result.missing],
        "stochastic": result.stochastic,
        "noises": [asdict(noise) | {"least": noise.least} for noise in result.noises],
        "recommendation": None
        if advice is None
        else asdict(advice[1]) | {"index": result.rows.index(advice[0]), "sentence": _advice(result)},
        "interrupted": result.interrupted,
    }


def machine() -> str:
    """Return the machine in words: everything known to Python that times depend on."""
    return (
        f"{usable_processors()} cores of {platform.machine()}, {platform.system()}, Python {platform.python_version()}"
    )


def tradeoff_lines(result: Tradeoff) -> list[str]:
    """Return the tables and the recommendation as lines for a terminal; the tables are also Markdown."""
    lines = [_title(result), ""]
    if result.rows:
        lines += [*markdown(_heads(result), _cells(result)), "", *_notes(result)]
    if result.noises:
        lines += ["", *markdown(*_noise_table(result.noises)), "", _noise_note(result)]
    lines += [f"{row.setting} was not measured: {row.problem}" for row in result.rows if row.problem]
    lines += [_missing(backend.name, backend.problem, backend.fix) for backend in result.missing]
    advice = _advice(result)
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
        "seconds": finite_or_none(row.seconds),
        "runs": row.runs,
        "memory_bytes": row.memory,
        "error": finite_or_none(row.error),
        "parameter_error": row.parameter_error,
        "pareto": pareto,
        "problem": row.problem or None,
    }


def _title(result: Tradeoff) -> str:
    height, width, channels = result.problem.image.shape
    scales = result.problem.scales
    listed = ", ".join(
        f"{name} {' '.join(f'{value:g}' for value in getattr(scales, name))}" for name in ("sigma", "alpha", "beta")
    )
    return f"{result.problem.name}: {height}x{width}x{channels}; {listed}; {machine()}"


def _heads(result: Tradeoff) -> list[str]:
    heads = ["backend", "accuracy", "dtype", "scales", "levels", "ms", "MiB", "error"]
    return [*heads, *(["of parameters"] if _has_parameters(result) else []), "Pareto"]


def _has_parameters(result: Tradeoff) -> bool:
    return any(row.parameter_error is not None for row in result.rows)


def _cells(result: Tradeoff) -> list[list[str]]:
    table = []
    for row, mark in zip(result.rows, result.pareto, strict=True):
        setting = row.setting
        device = f" ({row.device})" if row.device not in ("", "cpu") else ""
        cells = [setting.backend + device, setting.accuracy, setting.dtype, setting.change or "all"]
        cells += [str(setting.levels), formatted(1e3 * row.seconds, ".4g")]
        cells += [
            formatted(None if row.memory is None else row.memory / 2**20, ".1f"),
            formatted(row.error, ".1e"),
        ]
        if _has_parameters(result):
            cells.append(formatted(row.parameter_error, ".1e"))
        table.append([*cells, "*" if mark else ""])
    return table


def _noise_table(noises: Sequence[Noise]) -> tuple[list[str], list[list[str]]]:
    names = list(dict.fromkeys(name for noise in noises for name in noise.parameters))
    heads = ["samples per pixel", "ms", "seeds", *(f"noise of {name}" for name in names)]
    return heads, [
        [
            "-" if noise.samples is None else str(noise.samples),
            formatted(1e3 * noise.seconds, ".4g"),
            str(noise.seeds),
            *(formatted(noise.parameters.get(name), ".2g") for name in names),
        ]
        for noise in noises
    ]


def _notes(result: Tradeoff) -> list[str]:
    lines = [
        "ms: median of value and gradient. MiB: growth of the process's peak memory. error: of the image's gradient,",
        "relative, against exact in float64 on NumPy with all scales; other scales are another loss.",
    ]
    if _has_parameters(result):
        lines.append("of parameters: the largest error among the gradients of the parameters, which limits a fit.")
    elif any(
        row.setting.accuracy == "exact" and not row.setting.change and row.error > MAX_EXACT_ERROR
        for row in result.rows
    ):
        lines.append(
            "Large errors of float32: far from every difference it has no gradient where float64 still has one."
        )
        lines.append("Parameters seldom depend on those pixels; measure a scene, with --scene, to see their errors.")
    lines.append("*: in the Pareto set; no other setting is both faster and as accurate.")
    if result.load is not None and result.load > MAX_LOAD_PER_CORE * usable_processors():
        lines.append(f"The machine was busy when this began, with a load of {result.load:.1f}: times are too long.")
    if result.interrupted:
        lines.append("Interrupted: the table is not complete.")
    return lines


def _noise_note(result: Tradeoff) -> str:
    note = "Noise of the parameters' gradient from one seed, relative. ms: one render with its pullback."
    return note if result.noise is not None else f"{note} The scene's own count was not reached."


def _missing(name: str, problem: str, fix: str) -> str:
    return f"{name} was not measured: {problem}" + (f"; {fix}" if fix else "")


def _advice(result: Tradeoff) -> str:
    """Return the recommendation in words; empty if there is none."""
    if result.recommendation is None:
        return ""
    row, advice = result.recommendation
    setting = f"{row.setting}, {1e3 * row.seconds:.4g} ms"
    error = f"{advice.error:.1e}"
    if row.parameter_error is not None:
        error += " in the parameters' gradient"
    if advice.noise is not None:
        samples = None if result.noise is None else result.noise.samples
        noise = f"the renderer's own noise{'' if samples is None else f' at {samples} samples'}, {advice.noise:.1e}"
        if advice.is_allowed:
            return (
                f"{setting}. Its error, {error}, is less than {MAX_NOISE_FRACTION:.0%} of {noise}, and hides under it."
            )
        return f"{setting}, the most accurate. Its error, {error}, does not hide under {noise}."
    bound = f"the bound of balanced, {advice.allowed:g}"
    if not advice.is_allowed:
        return f"{setting}, the most accurate. No error is within {bound}; the error here is {error}."
    reason = (
        "nothing is random here" if result.stochastic is False else "without a renderer there is no noise to hide under"
    )
    return f"{setting}. It is the cheapest with an error, {error}, within {bound}; {reason}."


def _body(result: Tradeoff) -> str:
    problem = result.problem
    images = {"image": problem.image, "reference": problem.reference}
    figures = "".join(picture_figure(png_bytes(image), name) for name, image in images.items())
    rows = [list(map(escape, row)) for row in _cells(result)]
    table = html_table("Every setting", _heads(result), rows, text_columns=range(TEXT_COLUMNS))
    sections = [
        f"<main><h1>{escape(problem.name)}: the cost of accuracy</h1>",
        f'<p class="lead">{escape(_title(result))}</p>',
        f"<p><b>{escape(_advice(result))}</b></p>",
        f'<div class="row">{figures}</div>',
        f"<h2>Error and time</h2>{_chart(result)}",
        f"<h2>Every setting</h2>{table}<p>{escape(' '.join(_notes(result)))}</p>",
    ]
    if result.noises:
        heads, cells = _noise_table(result.noises)
        rows = [list(map(escape, row)) for row in cells]
        table = html_table("Noise of the renderer", heads, rows, text_columns=())
        sections.append(f"<h2>The renderer</h2>{table}<p>{escape(_noise_note(result))}</p>")
    sections += [f"<p>{escape(_missing(info.name, info.problem, info.fix))}</p>" for info in result.missing]
    return "\n".join([*sections, "</main>"])


def _chart(result: Tradeoff) -> str:
    """Return the chart of error against time, and the list of the Pareto set, which is joined and numbered in it."""
    measured = [(row, mark) for row, mark in zip(result.rows, result.pareto, strict=True) if not row.problem]
    front = sorted((1e3 * row.seconds, _plotted(row), str(row.setting)) for row, mark in measured if mark)
    times, errors = [time for time, _, _ in front], [error for _, error, _ in front]
    numbers = [str(number) for number in range(1, len(front) + 1)]
    lines = [Line("Pareto set", times, errors, PARETO_COLOUR, mark="steps", labels=numbers)]
    noise = None if result.noise is None else result.noise.least
    if noise is not None and measured:
        limits = [min(1e3 * row.seconds for row, _ in measured), max(1e3 * row.seconds for row, _ in measured)]
        lines.append(Line("noise of the renderer's gradient", limits, [noise, noise], NOISE_COLOUR))
    for colour, backend in enumerate(dict.fromkeys(row.setting.backend for row, _ in measured), FIRST_BACKEND_COLOUR):
        rows = [row for row, _ in measured if row.setting.backend == backend]
        lines.append(_points(backend, [row for row in rows if not row.setting.change], colour, "dot"))
        lines.append(
            _points(f"{backend}, other scales (crosses)", [row for row in rows if row.setting.change], colour, "cross")
        )
    gradient = "parameters'" if any(row.parameter_error is not None for row, _ in measured) else "image's"
    title = f"Relative error of the {gradient} gradient; at least {MIN_PLOTTED_ERROR:g} here"
    figure = chart_figure(Chart(title, lines, "value and gradient, ms", log_x=True, log_y=True))
    items = "".join(f"<li>{escape(name)}</li>" for _, _, name in front)
    return f'{figure.replace("chart panel", "chart plot panel", 1)}<ol aria-label="Pareto set">{items}</ol>'


def _points(name: str, rows: Sequence[Row], colour: int, mark: Literal["dot", "cross"]) -> Line:
    return Line(name, [1e3 * row.seconds for row in rows], list(map(_plotted, rows)), colour, mark=mark)


def _plotted(row: Row) -> float:
    return max(row.relevant_error, MIN_PLOTTED_ERROR)

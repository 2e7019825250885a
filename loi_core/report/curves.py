"""The charts of a run: convergence, the fraction of each scale, and the parameters by step."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

from loi_core.io.result_folder import HISTORY_FILE, SCALES_FILE
from loi_core.report.document import embedded_json
from loi_core.report.names import objective_label, scale_name
from loi_core.report.pictures import Pictures
from loi_core.report.tables import ScaleRows, read_columns, read_scale_rows
from loi_core.support.charts import COLOUR_COUNT, LEFT, RIGHT, WIDTH, Chart, Line, draw
from loi_core.support.values import real_number

__all__ = ["MAX_TABLE_BYTES", "chart_figure", "convergence_charts", "curves"]

MAX_TABLE_BYTES: Final = 2**26  # of a CSV file that is read
MAX_PARAMETER_CHARTS: Final = 24
MAX_TRUE_VALUES: Final = 128  # of one parameter
MAX_LEGEND: Final = 10  # lines in the legend of a chart
NOT_PARAMETERS: Final = frozenset({"step", "value", "gradient_norm", "rate", "seconds", "psnr", "stage"})
ELEMENT: Final = re.compile(r"(?P<name>.*)\[(?P<index>[0-9]{1,6})\]", re.DOTALL)
STAGES_NOTE: Final = "A new stage has another objective; its line continues from the end of the last one."

Columns = Mapping[str, Sequence[float]]


def curves(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """Return the sections of charts of a run, drawn from the tables in its folder."""
    histories, tables = {}, {}
    for index, trial in enumerate(result["trials"]):
        name, folder = trial["objective"], "" if index == 0 else f"compare/{trial['objective']}/"
        histories[name] = read_columns(pictures.text(f"{folder}{HISTORY_FILE}", MAX_TABLE_BYTES))
        tables[name] = read_scale_rows(pictures.text(f"{folder}{SCALES_FILE}", MAX_TABLE_BYTES))
    charts = convergence_charts(histories)
    charts += [_fraction_chart(name, rows) for name, rows in tables.items() if rows]
    figures = "".join(map(chart_figure, charts))
    if not figures:
        return []
    sections = [f'<h2>Convergence</h2><div class="charts">{figures}</div>']
    parameters = _parameter_charts(histories[result["trials"][0]["objective"]], result.get("truth"))
    figures = "".join(map(chart_figure, parameters))
    return [*sections, f'<h2>Parameters over time</h2><div class="charts">{figures}</div>'] if figures else sections


def convergence_charts(histories: Mapping[str, Columns]) -> list[Chart]:
    """Return the charts of the objective and the PSNR by step.

    Parameters
    ----------
    histories : dict
        The columns "step", "value", "psnr" and "stage" by the name of the objective.
    """
    relative = {name: _relative_values(columns) for name, columns in histories.items()}
    psnr = {name: columns.get("psnr", []) for name, columns in histories.items()}
    staged = any(len(set(columns.get("stage", ()))) > 1 for columns in histories.values())
    note = STAGES_NOTE if staged else ""
    return [
        Chart("Objective, relative to its start", _lines(histories, relative), log_y=True, note=note),
        Chart("PSNR against the target", _lines(histories, psnr), y_label="dB"),
    ]


def chart_figure(chart: Chart) -> str:
    """Return a chart with its legend, and its numbers for the script; empty if there is nothing to draw."""
    drawing = draw(chart)
    if drawing is None:
        return ""
    data = {
        "first": drawing.first,
        "last": drawing.last,
        "left": LEFT / WIDTH,
        "right": (WIDTH - RIGHT) / WIDTH,
        "fraction": chart.stacked,
        "lines": [{"steps": _rounded(line.x), "values": _rounded(line.y)} for line in drawing.lines],
    }
    keys = "".join(
        f'<li><span class="key c{line.colour % COLOUR_COUNT}"></span>{escape(line.name)} <span class="at"></span></li>'
        for line in drawing.lines[:MAX_LEGEND]
    )
    omitted = len(drawing.lines) - MAX_LEGEND
    keys += f"<li>and {omitted} more</li>" if omitted > 0 else ""
    note = f'<p class="soft">{escape(chart.note)}</p>' if chart.note else ""
    return (
        f'<figure class="chart panel"><h3>{escape(chart.title)}</h3>{drawing.svg}'
        f'<figcaption><ul class="legend">{keys}</ul>{note}</figcaption>'
        f'<script type="application/json">{embedded_json(data)}</script></figure>'
    )


def _rounded(values: Sequence[float]) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def _relative_values(columns: Columns) -> list[float]:
    """Return the objective over its first value; each stage starts where the one before ended."""
    values, stages = columns.get("value", []), columns.get("stage", [])
    relative: list[float] = []
    first, stage = math.nan, math.nan
    for index, value in enumerate(values):
        current = stages[index] if index < len(stages) else 0.0
        if index == 0 or (current != stage and not (math.isnan(current) and math.isnan(stage))):
            first, stage = value / (relative[-1] if relative and relative[-1] > 0.0 else 1.0), current
        relative.append(value / first if first else math.nan)
    return relative


def _lines(histories: Mapping[str, Columns], values: Mapping[str, Sequence[float]]) -> list[Line]:
    return [
        Line(objective_label(name), columns.get("step", []), values[name], colour)
        for colour, (name, columns) in enumerate(histories.items())
        if len(values[name]) == len(columns.get("step", []))
    ]


def _fractions(rows: ScaleRows) -> tuple[list[int], dict[tuple[float, float, float], list[float]]]:
    """Return the steps where all scales have a value, and the fraction of each scale there."""
    common = set.intersection(*(set(values) for values in rows.values()))
    totals = {step: math.fsum(max(values[step], 0.0) for values in rows.values()) for step in sorted(common)}
    steps = [step for step, total in totals.items() if 0.0 < total < math.inf]
    return steps, {key: [max(values[step], 0.0) / totals[step] for step in steps] for key, values in rows.items()}


def _fraction_chart(name: str, rows: ScaleRows) -> Chart:
    steps, fractions = _fractions(rows)
    lines = [Line(scale_name(*key), steps, values, colour) for colour, (key, values) in enumerate(fractions.items())]
    title = f"Share of each scale of {objective_label(name)}"
    return Chart(title, lines, stacked=True, note="Of the last stage's objective, at the recorded steps.")


def _parameter_charts(columns: Columns, truth: object) -> list[Chart]:
    """Return a chart for each parameter, with a line for each of its numbers."""
    groups: dict[str, list[tuple[str, int, Sequence[float]]]] = {}
    for column, values in columns.items():
        if column not in NOT_PARAMETERS:
            element = ELEMENT.fullmatch(column)
            name, index = (element["name"], int(element["index"])) if element else (column, 0)
            groups.setdefault(name, []).append((column, index, values))
    charts = []
    steps = columns.get("step", [])
    for name, members in list(groups.items())[:MAX_PARAMETER_CHARTS]:
        true_values = _flat_numbers(truth.get(name)) if isinstance(truth, Mapping) else []
        lines = []
        for colour, (column, index, values) in enumerate(members):
            true_value = true_values[index] if index < len(true_values) else math.nan
            level = true_value if math.isfinite(true_value) else None
            if len(values) == len(steps):
                lines.append(Line(column.removeprefix(name) or name, steps, values, colour, level))
        note = "Dashed: the true values." if any(line.level is not None for line in lines) else ""
        charts.append(Chart(name, lines, note=note))
    return charts


def _flat_numbers(value: object) -> list[float]:
    """Return the numbers in nested lists, at most `MAX_TRUE_VALUES`."""
    numbers: list[float] = []
    waiting = [value]
    while waiting and len(numbers) < MAX_TRUE_VALUES:
        item = waiting.pop(0)
        if isinstance(item, list):
            waiting = [*item[:MAX_TRUE_VALUES], *waiting]
        else:
            numbers.append(real_number(item))
    return numbers

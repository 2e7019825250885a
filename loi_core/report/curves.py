"""The curves of a run: how it converged, what each scale had of it, and where its parameters went."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

from loi_core.io.result_folder import HISTORY_FILE, SCALES_FILE
from loi_core.report.charts import Chart, Line, draw
from loi_core.report.kept import Pictures
from loi_core.report.plots import LABELS
from loi_core.report.records import ScaleRows, read_columns, read_scale_rows
from loi_core.report.scales import scale_name
from loi_core.report.viewer import MOST_TABLE
from loi_core.support.values import real_number

__all__ = ["curves"]

OTHERS: Final = frozenset({"step", "value", "gradient_norm", "rate", "seconds", "psnr", "stage"})
ELEMENT: Final = re.compile(r"(?P<name>.*)\[(?P<index>[0-9]{1,6})\]", re.DOTALL)
MOST_CHARTS: Final = 24  # of parameters
STAGED: Final = "A new stage has another objective; its line goes on from where the last one ended."


def curves(pictures: Pictures, result: Mapping[str, Any]) -> list[str]:
    """Charts of a run from its tables; the picture of an older one if it has no tables."""
    histories, tables = {}, {}
    for index, trial in enumerate(result["trials"]):
        name, own = trial["objective"], "" if index == 0 else f"compare/{trial['objective']}/"
        histories[name] = read_columns(pictures.text(f"{own}{HISTORY_FILE}", MOST_TABLE))
        tables[name] = read_scale_rows(pictures.text(f"{own}{SCALES_FILE}", MOST_TABLE))
    descent = [_relative(columns) for columns in histories.values()]
    staged = any(len(set(columns.get("stage", ()))) > 1 for columns in histories.values())
    charts = [
        Chart("Objective, relative to its start", _lines(histories, descent), log=True, note=STAGED if staged else ""),
        Chart(
            "PSNR against the target",
            _lines(histories, [columns.get("psnr", []) for columns in histories.values()]),
            unit="dB",
        ),
    ]
    charts += [_shares(name, rows) for name, rows in tables.items() if rows]
    drawn = [one for one in map(draw, charts) if one]
    if not drawn:
        plot = pictures.figure("convergence.png", "objective and PSNR by step", image_class="plot")
        return [f"<h2>Convergence</h2>{plot}"] if plot else []
    parts = [f'<h2>Convergence</h2><div class="charts">{"".join(drawn)}</div>']
    parts += [_share_table(name, rows) for name, rows in tables.items() if rows]
    first = histories[result["trials"][0]["objective"]]
    moved = [one for one in map(draw, _parameters(first, result.get("truth"))) if one]
    if moved:
        parts.append(f'<h2>Parameters over time</h2><div class="charts">{"".join(moved)}</div>')
    return parts


def _relative(columns: Mapping[str, Sequence[float]]) -> list[float]:
    """The objective over its first value; a stage, which has another objective, goes on where the last one ended."""
    values, stages = columns.get("value", []), columns.get("stage", [])
    found: list[float] = []
    first, stage = math.nan, math.nan
    for index, value in enumerate(values):
        now = stages[index] if index < len(stages) else 0.0
        if index == 0 or (now != stage and not (math.isnan(now) and math.isnan(stage))):
            first, stage = value / (found[-1] if found and found[-1] > 0.0 else 1.0), now
        found.append(value / first if first else math.nan)
    return found


def _lines(histories: Mapping[str, Mapping[str, Sequence[float]]], values: Sequence[Sequence[float]]) -> list[Line]:
    return [
        Line(LABELS.get(name, name), columns.get("step", []), each, colour)
        for colour, ((name, columns), each) in enumerate(zip(histories.items(), values, strict=True))
        if len(each) == len(columns.get("step", []))
    ]


def _shares(name: str, rows: ScaleRows) -> Chart:
    """What part of the value each scale has at the recorded steps."""
    steps, parts = _parts(rows)
    lines = [Line(scale_name(*key), steps, each, colour) for colour, (key, each) in enumerate(parts.items())]
    return Chart(
        f"Share of each scale of {LABELS.get(name, name)}",
        lines,
        stacked=True,
        note="Of the last stage's objective, at the recorded steps.",
    )


def _parts(rows: ScaleRows) -> tuple[list[int], dict[tuple[float, float, float], list[float]]]:
    """The steps at which all scales have a value, and the share of each."""
    common = set.intersection(*(set(one) for one in rows.values()))
    totals = {step: math.fsum(max(one[step], 0.0) for one in rows.values()) for step in sorted(common)}
    steps = [step for step, total in totals.items() if 0.0 < total < math.inf]
    return steps, {key: [max(one[step], 0.0) / totals[step] for step in steps] for key, one in rows.items()}


def _share_table(name: str, rows: ScaleRows) -> str:
    """The same as numbers."""
    steps, parts = _parts(rows)
    if not steps:
        return ""
    heads = "".join(f'<th scope="col" class="n">{escape(scale_name(*key))}</th>' for key in parts)
    lines = [
        f'<tr><th scope="row" class="n">{step}</th>'
        + "".join(f'<td class="n">{rows[key][step]:.4g} ({each[index]:.0%})</td>' for key, each in parts.items())
        + "</tr>"
        for index, step in enumerate(steps)
    ]
    head = f'<thead><tr><th scope="col" class="n">step</th>{heads}</tr></thead>'
    table = f"<table>{head}<tbody>{''.join(lines)}</tbody></table>"
    label = escape(f"Scales of {LABELS.get(name, name)} as numbers")
    return (
        f'<details><summary>{label}</summary><div class="scroll" role="group" tabindex="0" aria-label="{label}">'
        f"{table}</div></details>"
    )


def _parameters(columns: Mapping[str, Sequence[float]], truth: object) -> list[Chart]:
    """A chart for each parameter, with all of its numbers."""
    groups: dict[str, list[tuple[str, int, Sequence[float]]]] = {}
    for column, values in columns.items():
        if column not in OTHERS:
            part = ELEMENT.fullmatch(column)
            name, index = (part["name"], int(part["index"])) if part else (column, 0)
            groups.setdefault(name, []).append((column, index, values))
    charts = []
    for name, members in list(groups.items())[:MOST_CHARTS]:
        known = _flat(truth.get(name)) if isinstance(truth, Mapping) else []
        lines = [
            Line(
                column.removeprefix(name) or name,
                columns.get("step", []),
                values,
                colour,
                known[index] if index < len(known) and math.isfinite(known[index]) else None,
            )
            for colour, (column, index, values) in enumerate(members)
            if len(values) == len(columns.get("step", []))
        ]
        known_lines = any(line.level is not None for line in lines)
        charts.append(Chart(name, lines, note="Dashed: the true values." if known_lines else ""))
    return charts


def _flat(value: object) -> list[float]:
    """The numbers in a nest of lists, as far as a parameter has any."""
    found: list[float] = []
    waiting = [value]
    while waiting and len(found) < 128:
        one = waiting.pop(0)
        if isinstance(one, list):
            waiting = [*one[:128], *waiting]
        else:
            found.append(real_number(one))
    return found

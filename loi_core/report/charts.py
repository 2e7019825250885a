"""Charts that are drawn in the page: lines and shares by step, as SVG in the page's own colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from loi_core.report.document import embedded_json

__all__ = ["COLOURS", "Chart", "Line", "draw"]

COLOURS: Final = 8  # of lines, in the style
WIDTH, HEIGHT = 420, 250
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 10, 36
MOST_POINTS: Final = 400  # of a line
MOST_NAMED: Final = 10  # lines in the legend
LARGEST: Final = 1e300  # beyond, differences overflow
LEAST: Final = 1e-290  # nearer to 0 than this, a value is drawn there
MOST_STEP: Final = 2**50
DECADES: Final = 18  # that an axis reaches down from its largest value
TICKS: Final = 4


@dataclass(frozen=True)
class Line:
    """A line of a chart.

    Attributes
    ----------
    name : str
    steps, values : sequence of float
        Of the same length; values that are not finite are left out.
    colour : int
        Which of the page's colours.
    level : float, optional
        A value that it should come to, drawn as a dashed line.
    """

    name: str
    steps: Sequence[float]
    values: Sequence[float]
    colour: int = 0
    level: float | None = None


@dataclass(frozen=True)
class Chart:
    """A chart by step.

    Attributes
    ----------
    title : str
    lines : sequence of Line
    unit : str
        Of the values.
    log : bool
        Whether the axis of values is logarithmic; values of 0 or less are left out.
    stacked : bool
        Whether the values are shares of 1 that are stacked; all lines have the same steps.
    note : str
        A sentence below it.
    """

    title: str
    lines: Sequence[Line]
    unit: str = ""
    log: bool = False
    stacked: bool = False
    note: str = ""


def draw(chart: Chart) -> str:
    """A chart as a figure in HTML; empty if there is nothing to draw."""
    lines = [one for one in (_thinned(line, log=chart.log) for line in chart.lines) if one.steps]
    if not lines:
        return ""
    first = min(line.steps[0] for line in lines)
    last = max(max(line.steps[-1] for line in lines), first + 1.0)
    scale = _Scale.of(chart, lines)
    place = _Place(first, last, scale)
    marks = _areas(lines, place) if chart.stacked else _curves(lines, place)
    told = f"{chart.title}, by step. {_ends(lines, chart)}"
    svg = (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(told)}">{_axes(place, chart)}{marks}'
        f'<line class="now" x1="{LEFT}" x2="{LEFT}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/></svg>'
    )
    data = {
        "first": first,
        "last": last,
        "left": LEFT / WIDTH,
        "right": (WIDTH - RIGHT) / WIDTH,
        "share": chart.stacked,
        "lines": [
            {"steps": [_short(one) for one in line.steps], "values": [_short(one) for one in line.values]}
            for line in lines
        ],
    }
    named = "".join(
        f'<li><span class="key c{line.colour % COLOURS}"></span>{escape(line.name)} <span class="at"></span></li>'
        for line in lines[:MOST_NAMED]
    )
    more = f"<li>and {len(lines) - MOST_NAMED} more</li>" if len(lines) > MOST_NAMED else ""
    note = f'<p class="soft">{escape(chart.note)}</p>' if chart.note else ""
    return (
        f'<figure class="chart panel"><h3>{escape(chart.title)}</h3>{svg}'
        f'<figcaption><ul class="legend">{named}{more}</ul>{note}</figcaption>'
        f'<script type="application/json">{embedded_json(data)}</script></figure>'
    )


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def _thinned(line: Line, *, log: bool) -> Line:
    """The points of a line that can be drawn, and of those so many that a page can hold them."""
    kept = [
        (step, value if abs(value) > LEAST else 0.0)
        for step, value in zip(line.steps, line.values, strict=True)
        if abs(step) < MOST_STEP and abs(value) < LARGEST and (value > LEAST or not log)
    ]
    kept.sort(key=lambda point: point[0])
    if len(kept) > MOST_POINTS:
        kept = [kept[round(k * (len(kept) - 1) / (MOST_POINTS - 1))] for k in range(MOST_POINTS)]
    level = line.level if line.level is not None and abs(line.level) < LARGEST else None
    return Line(line.name, [one[0] for one in kept], [one[1] for one in kept], line.colour, level)


@dataclass(frozen=True)
class _Scale:
    """The axis of values."""

    low: float
    high: float
    log: bool
    ticks: tuple[float, ...]

    @classmethod
    def of(cls, chart: Chart, lines: Sequence[Line]) -> _Scale:
        if chart.stacked:
            return cls(0.0, 1.0, log=False, ticks=(0.0, 0.25, 0.5, 0.75, 1.0))
        values = [value for line in lines for value in line.values]
        values += [line.level for line in lines if line.level is not None]
        if chart.log:
            high = max(math.log10(max(values)), -300.0)
            low = max(min(math.log10(value) for value in values), high - DECADES)
            low, high = math.floor(low), max(math.ceil(high), math.floor(low) + 1)
            every = max(1, math.ceil((high - low) / TICKS))
            return cls(low, high, log=True, ticks=tuple(range(int(low), int(high) + 1, every)))
        low, high = min(values), max(values)
        if high - low <= 1e-9 * max(abs(low), abs(high)):
            room = 0.5 * max(abs(low), abs(high)) or 1.0
            low, high = low - room, high + room
        step = _round_step((high - low) / TICKS)
        below, above = math.floor(low / step), math.ceil(high / step)
        return cls(below * step, above * step, log=False, ticks=tuple(k * step for k in range(below, above + 1)))

    def share(self, value: float) -> float:
        """Where a value lies between the ends, from 0 to 1."""
        at = math.log10(value) if self.log else value
        return min(max((at - self.low) / (self.high - self.low), 0.0), 1.0)

    def label(self, tick: float) -> str:
        return _power(int(tick)) if self.log else f"{tick:.6g}"


def _power(exponent: int) -> str:
    return f"{10.0**exponent:g}" if -3 <= exponent <= 3 else f"1e{exponent}"


def _round_step(least: float) -> float:
    """1, 2 or 5 times a power of ten, not less than this."""
    power = 10.0 ** math.floor(math.log10(least))
    return next((factor * power for factor in (1.0, 2.0, 5.0) if factor * power >= least), 10.0 * power)


@dataclass(frozen=True)
class _Place:
    """Where steps and values lie on the drawing."""

    first: float
    last: float
    scale: _Scale

    def x(self, step: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (step - self.first) / (self.last - self.first)

    def y(self, value: float) -> float:
        return self.height(self.scale.share(value))

    def height(self, share: float) -> float:
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share


def _axes(place: _Place, chart: Chart) -> str:
    parts = []
    scale = place.scale
    for tick in scale.ticks:
        y = place.height((tick - scale.low) / (scale.high - scale.low))
        label = f"{tick:.0%}" if chart.stacked else scale.label(tick)
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{escape(label)}</text>')
    step = max(1.0, _round_step((place.last - place.first) / TICKS))
    counted = [k * step for k in range(math.ceil(place.first / step), math.floor(place.last / step) + 1)]
    parts += [f'<text x="{place.x(one):.1f}" y="{HEIGHT - 18}" text-anchor="middle">{one:g}</text>' for one in counted]
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle:.0f}" y="{HEIGHT - 2}" text-anchor="middle">step</text>')
    if chart.unit:
        parts.append(f'<text class="unit" x="{LEFT + 4}" y="{TOP + 12}">{escape(chart.unit)}</text>')
    return "".join(parts)


def _curves(lines: Sequence[Line], place: _Place) -> str:
    parts = []
    for line in reversed(lines):  # the first lies on top
        kind = f"c{line.colour % COLOURS}"
        points = " ".join(
            f"{place.x(step):.1f},{place.y(value):.1f}" for step, value in zip(line.steps, line.values, strict=True)
        )
        if line.level is not None:
            y = place.y(line.level)
            parts.append(f'<path class="truth {kind}" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        if len(line.steps) == 1:
            x, high = points.split(",")
            parts.append(f'<circle class="dot {kind}" cx="{x}" cy="{high}" r="3"/>')
        parts.append(f'<polyline class="line {kind}" points="{points}"/>')
    return "".join(parts)


def _areas(lines: Sequence[Line], place: _Place) -> str:
    parts = []
    base = [0.0] * len(lines[0].steps)
    for line in lines:
        top = [low + value for low, value in zip(base, line.values, strict=True)]
        over = [f"{place.x(step):.1f},{place.y(value):.1f}" for step, value in zip(line.steps, top, strict=True)]
        under = [f"{place.x(step):.1f},{place.y(value):.1f}" for step, value in zip(line.steps, base, strict=True)]
        parts.append(f'<polygon class="area c{line.colour % COLOURS}" points="{" ".join([*over, *reversed(under)])}"/>')
        base = top
    return "".join(parts)


def _ends(lines: Sequence[Line], chart: Chart) -> str:
    """Where the lines begin and end, in words."""

    def said(value: float) -> str:
        return f"{value:.0%}" if chart.stacked else f"{value:.4g}"

    parts = [f"{line.name}: from {said(line.values[0])} to {said(line.values[-1])}" for line in lines[:MOST_NAMED]]
    return "; ".join(parts) + (f"; and {len(lines) - MOST_NAMED} more" if len(lines) > MOST_NAMED else "")

"""Charts as SVG text: lines, stacked fractions and points, on linear or logarithmic axes.

Marks carry classes (``line``, ``area``, ``dot``, ``grid``, ..., and ``c0`` to ``c7`` for colours) for the style sheet
of a page. A sparkline needs no style sheet.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Final, Literal

__all__ = ["COLOUR_COUNT", "HEIGHT", "LEFT", "RIGHT", "WIDTH", "Chart", "Drawing", "Line", "draw", "sparkline"]

COLOUR_COUNT: Final = 8  # classes c0 to c7 in the style sheet
WIDTH, HEIGHT = 420, 250  # of a chart with axes, in units of its view box
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 10, 36  # margins for the labels
SPARK_MARGIN: Final = 4
MAX_POINTS: Final = 400  # of a line
MAX_DESCRIBED: Final = 10  # lines in the description
MAX_X: Final = 2.0**50
MAX_Y: Final = 1e300  # differences of larger values overflow
MIN_MAGNITUDE: Final = 1e-290  # smaller values are drawn as 0
MAX_DECADES: Final = 18  # of a logarithmic axis, below its largest value
TICK_COUNT: Final = 4

Point = tuple[float, float]


@dataclass(frozen=True)
class Line:
    """A series of points of a chart.

    Attributes
    ----------
    name : str
    x, y : sequence of float
        Of the same length. Points that are not finite are left out.
    colour : int
        Index of one of the page's colours.
    level : float, optional
        A value of y that is drawn as a dashed line, such as the true value of a parameter.
    mark : {"line", "steps", "dot", "cross"}
        "steps" joins the points by horizontal and vertical lines; "dot" and "cross" do not join them.
    labels : sequence of str
        A text beside each point; empty for none.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    level: float | None = None
    mark: Literal["line", "steps", "dot", "cross"] = "line"
    labels: Sequence[str] = ()


@dataclass(frozen=True)
class Chart:
    """Lines on common axes.

    Attributes
    ----------
    title : str
    lines : sequence of Line
    x_label, y_label : str
    log_x, log_y : bool
        Whether an axis is logarithmic. Values of 0 or less are left out then.
    stacked : bool
        Whether the values are fractions of 1 that are stacked. All lines have the same x.
    note : str
        A sentence below the chart.
    """

    title: str
    lines: Sequence[Line]
    x_label: str = "step"
    y_label: str = ""
    log_x: bool = False
    log_y: bool = False
    stacked: bool = False
    note: str = ""


@dataclass(frozen=True)
class Drawing:
    """A chart as SVG.

    Attributes
    ----------
    svg : str
    lines : tuple of Line
        The lines that have points, with the points that are drawn.
    first, last : float
        The values of x at the left and right end of the axis; their logarithms to base 10 if it is logarithmic.
    """

    svg: str
    lines: tuple[Line, ...]
    first: float
    last: float


def draw(chart: Chart) -> Drawing | None:
    """Draw a chart; None if no line has a point that can be drawn."""
    lines = tuple(line for line in (_drawable(line, chart) for line in chart.lines) if line.x)
    if not lines:
        return None
    xs = [x for line in lines for x in line.x]
    ys = [y for line in lines for y in line.y] + [line.level for line in lines if line.level is not None]
    frame = _Frame(
        _decades(xs) if chart.log_x else _exact(xs),
        _Axis(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0))
        if chart.stacked
        else _decades(ys)
        if chart.log_y
        else _rounded(ys),
    )
    marks = _areas(lines, frame) if chart.stacked else "".join(_marks(line, frame) for line in reversed(lines))
    svg = (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(_description(chart, lines))}">'
        f"{_axes(frame, chart)}{marks}"
        f'<line class="now" x1="{LEFT}" x2="{LEFT}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/></svg>'
    )
    return Drawing(svg, lines, frame.x_axis.lower, frame.x_axis.upper)


def sparkline(
    lines: Iterable[Sequence[Point]], label: str, *, width: int = 240, height: int = 56, shaded_to: float | None = None
) -> str:
    """Draw lines without axes in a small frame; the empty string if no line has two finite points.

    Parameters
    ----------
    lines : iterable of sequence of (float, float)
        Points (x, y) of each line.
    label : str
        The text for those who do not see the lines.
    width, height : int
        In CSS pixels.
    shaded_to : float, optional
        The end of the shaded background, in x.
    """
    finite = [[point for point in line if all(map(math.isfinite, point))] for line in lines]
    finite = [line for line in finite if len(line) > 1]
    if not finite:
        return ""
    x_axis, y_axis = (_exact([point[index] for line in finite for point in line]) for index in (0, 1))

    def position(point: Point) -> str:
        x = SPARK_MARGIN + (width - 2 * SPARK_MARGIN) * x_axis.fraction(point[0])
        y = height - SPARK_MARGIN - (height - 2 * SPARK_MARGIN) * y_axis.fraction(point[1])
        return f"{x:.1f},{y:.1f}"

    shade = ""
    if shaded_to is not None:
        shade_width = SPARK_MARGIN + (width - 2 * SPARK_MARGIN) * x_axis.fraction(shaded_to)
        shade = (
            f'<rect class="shade" fill="currentColor" fill-opacity=".15" width="{shade_width:.1f}" height="{height}"/>'
        )
    polylines = "".join(
        f'<polyline points="{" ".join(map(position, line))}" fill="none" stroke="currentColor" stroke-width="1.5"/>'
        for line in finite
    )
    return (
        f'<svg class="spark" role="img" aria-label="{escape(label)}" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">{shade}{polylines}</svg>'
    )


@dataclass(frozen=True)
class _Axis:
    """The range of an axis and its ticks; all are logarithms if `log`."""

    lower: float
    upper: float
    ticks: tuple[float, ...]
    log: bool = False

    def fraction(self, value: float) -> float:
        """Return the position of a value along the axis, in [0, 1]."""
        position = math.log10(value) if self.log else value
        return min(max((position - self.lower) / (self.upper - self.lower), 0.0), 1.0)

    def label(self, tick: float) -> str:
        if not self.log:
            return f"{tick:.6g}"
        return f"{10.0**tick:g}" if -3 <= tick <= 3 else f"1e{int(tick)}"


def _decades(values: Sequence[float]) -> _Axis:
    """Return a logarithmic axis of whole decades."""
    upper = max(math.log10(max(values)), -300.0)
    lower = math.floor(max(min(math.log10(value) for value in values), upper - MAX_DECADES))
    upper = max(math.ceil(upper), lower + 1)
    return _Axis(
        lower, upper, tuple(range(lower, upper + 1, max(1, math.ceil((upper - lower) / TICK_COUNT)))), log=True
    )


def _exact(values: Sequence[float]) -> _Axis:
    """Return an axis from the smallest to the largest value, of length 1 if they are equal; ticks lie within it."""
    lower, upper = min(values), max(values)
    if upper <= lower:
        upper = lower + 1.0
    step = _round_step((upper - lower) / TICK_COUNT)
    return _Axis(lower, upper, tuple(k * step for k in range(math.ceil(lower / step), math.floor(upper / step) + 1)))


def _rounded(values: Sequence[float]) -> _Axis:
    """Return an axis whose ends are ticks."""
    lower, upper = min(values), max(values)
    if upper - lower <= 1e-9 * max(abs(lower), abs(upper)):
        margin = 0.5 * max(abs(lower), abs(upper)) or 1.0
        lower, upper = lower - margin, upper + margin
    step = _round_step((upper - lower) / TICK_COUNT)
    first, last = math.floor(lower / step), math.ceil(upper / step)
    return _Axis(first * step, last * step, tuple(k * step for k in range(first, last + 1)))


def _round_step(minimum: float) -> float:
    """Return the least number of at least `minimum` that is 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(minimum))
    return next((factor * power for factor in (1.0, 2.0, 5.0) if factor * power >= minimum), 10.0 * power)


@dataclass(frozen=True)
class _Frame:
    """The positions of values on a chart."""

    x_axis: _Axis
    y_axis: _Axis

    def x(self, value: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * self.x_axis.fraction(value)

    def y(self, value: float) -> float:
        return self.height(self.y_axis.fraction(value))

    @staticmethod
    def height(fraction: float) -> float:
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * fraction

    def points(self, x: Sequence[float], y: Sequence[float]) -> list[str]:
        return [f"{self.x(x_value):.1f},{self.y(y_value):.1f}" for x_value, y_value in zip(x, y, strict=True)]


def _drawable(line: Line, chart: Chart) -> Line:
    """Return a line with the points that can be drawn, at most `MAX_POINTS` of them."""
    labels = line.labels or [""] * len(line.x)
    points = [
        (x, y if abs(y) > MIN_MAGNITUDE else 0.0, label)
        for x, y, label in zip(line.x, line.y, labels, strict=True)
        if abs(x) < MAX_X and abs(y) < MAX_Y and (y > MIN_MAGNITUDE or not chart.log_y) and (x > 0.0 or not chart.log_x)
    ]
    points.sort(key=lambda point: point[0])
    if len(points) > MAX_POINTS:
        points = [points[round(k * (len(points) - 1) / (MAX_POINTS - 1))] for k in range(MAX_POINTS)]
    level = line.level
    if level is not None and not (abs(level) < MAX_Y and (level > MIN_MAGNITUDE or not chart.log_y)):
        level = None
    return replace(
        line, x=[x for x, _, _ in points], y=[y for _, y, _ in points], labels=[t for *_, t in points], level=level
    )


def _axes(frame: _Frame, chart: Chart) -> str:
    elements = []
    y_axis, x_axis = frame.y_axis, frame.x_axis
    for tick in y_axis.ticks:
        y = frame.height((tick - y_axis.lower) / (y_axis.upper - y_axis.lower))
        label = f"{tick:.0%}" if chart.stacked else y_axis.label(tick)
        elements.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        elements.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{escape(label)}</text>')
    for tick in x_axis.ticks:
        x = LEFT + (WIDTH - LEFT - RIGHT) * (tick - x_axis.lower) / (x_axis.upper - x_axis.lower)
        elements.append(f'<text x="{x:.1f}" y="{HEIGHT - 18}" text-anchor="middle">{x_axis.label(tick)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    elements.append(f'<text x="{middle:.0f}" y="{HEIGHT - 2}" text-anchor="middle">{escape(chart.x_label)}</text>')
    if chart.y_label:
        elements.append(f'<text class="unit" x="{LEFT + 4}" y="{TOP + 12}">{escape(chart.y_label)}</text>')
    return "".join(elements)


def _marks(line: Line, frame: _Frame) -> str:
    colour = f"c{line.colour % COLOUR_COUNT}"
    elements = []
    if line.level is not None:
        elements.append(f'<path class="level {colour}" d="M{LEFT} {frame.y(line.level):.1f}H{WIDTH - RIGHT}"/>')
    points = frame.points(line.x, line.y)
    if line.mark == "line" and len(points) > 1:
        elements.append(f'<polyline class="line {colour}" points="{" ".join(points)}"/>')
    elif line.mark == "steps":
        corners = [f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in zip(line.x[1:], line.y, strict=False)]
        joined = [point for pair in zip(points[1:], corners, strict=True) for point in reversed(pair)]
        elements.append(f'<polyline class="line {colour}" points="{" ".join([points[0], *joined])}"/>')
    else:
        for point in points:
            x, y = point.split(",")
            if line.mark == "cross":
                elements.append(f'<path class="cross {colour}" d="M{x} {y}m-3-3l6 6m-6 0l6-6"/>')
            else:
                elements.append(f'<circle class="dot {colour}" cx="{x}" cy="{y}" r="3"/>')
    elements += [
        f'<text class="label" x="{frame.x(x) + 5:.1f}" y="{frame.y(y) - 4:.1f}">{escape(label)}</text>'
        for x, y, label in zip(line.x, line.y, line.labels, strict=True)
        if label
    ]
    return "".join(elements)


def _areas(lines: Sequence[Line], frame: _Frame) -> str:
    elements = []
    base = [0.0] * len(lines[0].x)
    for line in lines:
        top = [height + value for height, value in zip(base, line.y, strict=True)]
        outline = [*frame.points(line.x, top), *reversed(frame.points(line.x, base))]
        elements.append(f'<polygon class="area c{line.colour % COLOUR_COUNT}" points="{" ".join(outline)}"/>')
        base = top
    return "".join(elements)


def _description(chart: Chart, lines: Sequence[Line]) -> str:
    """Return the title and the first and last value of each line, in words."""

    def spelled(value: float) -> str:
        return f"{value:.0%}" if chart.stacked else f"{value:.4g}"

    ranges = [f"{line.name}: from {spelled(line.y[0])} to {spelled(line.y[-1])}" for line in lines[:MAX_DESCRIBED]]
    if len(lines) > MAX_DESCRIBED:
        ranges.append(f"and {len(lines) - MAX_DESCRIBED} more")
    return f"{chart.title}, by {chart.x_label}. {'; '.join(ranges)}"

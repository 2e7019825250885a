"""Charts as SVG: every number stays within the frame, and every text is escaped."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from loi_core.support.charts import MAX_POINTS, Chart, Line, draw, sparkline

EXTREMES = [0.0, 1.0, -1.0, 1e308, 1e-300, 5e-324, np.nan, np.inf, 7.0]


def svg_of(chart: Chart) -> str:
    drawing = draw(chart)
    assert drawing is not None
    ET.fromstring(drawing.svg)  # noqa: S314  # our own
    return drawing.svg


@pytest.mark.parametrize("log_x", [False, True])
@pytest.mark.parametrize("log_y", [False, True])
def test_charts_of_any_numbers_stay_within_their_frame(log_x: bool, log_y: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        size = int(rng.integers(1, 5))
        y = [float(value) for value in rng.choice(EXTREMES, size)]
        x = [float(value) for value in rng.choice([0.0, 1.0, 2.0, 1e17, -4.0, np.nan], size)]
        level = float(rng.choice([1.0, np.nan, 1e305]))
        drawing = draw(Chart("a", [Line("b", x, y, 0, level)], log_x=log_x, log_y=log_y))
        for points in re.findall(r'points="([^"]*)"', drawing.svg if drawing else ""):
            for point in points.split():
                x_px, y_px = map(float, point.split(","))
                assert 50.0 <= x_px <= 420.0
                assert 0.0 <= y_px <= 250.0


def test_a_chart_without_a_finite_point_is_not_drawn() -> None:
    assert draw(Chart("empty", [Line("a", [0.0, 1.0], [np.nan, np.inf])])) is None
    assert draw(Chart("empty", [Line("a", [1.0], [-1.0])], log_y=True)) is None


def test_a_long_line_keeps_its_ends_and_a_bounded_number_of_points() -> None:
    drawing = draw(Chart("long", [Line("a", range(10_000), range(10_000))]))
    assert drawing is not None
    (line,) = drawing.lines
    assert len(line.x) == MAX_POINTS
    assert (line.x[0], line.x[-1]) == (0, 9999)


def test_names_in_a_chart_are_escaped() -> None:
    svg = svg_of(Chart("<b>", [Line("</svg>", [0.0, 1.0], [1.0, 2.0], labels=["<i>", ""])], y_label="&"))
    assert "<b>" not in svg
    assert "<i>" not in svg
    assert svg.count("</svg>") == 1


def test_steps_join_points_by_horizontal_and_vertical_lines() -> None:
    svg = svg_of(Chart("a", [Line("b", [1.0, 10.0, 100.0], [1.0, 0.1, 0.01], mark="steps")], log_x=True, log_y=True))
    (points,) = re.findall(r'points="([^"]*)"', svg)
    corners = [tuple(map(float, point.split(","))) for point in points.split()]
    assert len(corners) == 5
    assert all(a[0] == b[0] or a[1] == b[1] for a, b in itertools.pairwise(corners))


def test_unconnected_points_are_dots_or_crosses_with_their_labels() -> None:
    lines = [Line("a", [1.0, 2.0], [3.0, 4.0], mark="dot", labels=["1", "2"]), Line("b", [1.5], [3.5], mark="cross")]
    svg = svg_of(Chart("points", lines))
    assert svg.count('class="dot') == 2
    assert svg.count('class="cross') == 1
    assert len(re.findall(r'class="label"[^>]*>[12]<', svg)) == 2


def test_stacked_fractions_fill_the_chart() -> None:
    svg = svg_of(Chart("a", [Line("b", [0, 1], [0.25, 0.5]), Line("c", [0, 1], [0.75, 0.5])], stacked=True))
    areas = [points.split() for points in re.findall(r'<polygon[^>]*points="([^"]*)"', svg)]
    heights = [[float(point.split(",")[1]) for point in area] for area in areas]
    assert heights[0][2:] == [214.0, 214.0]  # the axis
    assert heights[1][:2] == [10.0, 10.0]  # the top
    assert heights[1][2:] == heights[0][1::-1]


def test_a_sparkline_needs_two_finite_points() -> None:
    assert sparkline([[(0.0, 1.0)], [(0.0, np.nan), (1.0, 2.0)]], "none") == ""
    svg = sparkline([[(0.0, 1.0), (1.0, np.inf), (2.0, 3.0)]], "two", shaded_to=1.0)
    assert svg.count(",") == 2
    assert 'class="shade"' in svg

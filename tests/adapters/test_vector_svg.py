"""Tests of SVG files: lossless writing and reading, equivalent spellings, and errors of one line."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.errors import SvgError
from loi_core.scenes.reading import load_scene
from loi_torch.vector import Circle, Ellipse, Outline, Paint, Path, Rectangle, Vector, read_svg, write_svg

NUMBERS = st.floats(-100.0, 100.0)
SIZES = st.floats(0.1, 50.0)
COLOURS = st.tuples(*[st.floats(0.0, 1.0)] * 4)
POINTS = st.tuples(NUMBERS, NUMBERS)
FILLS = COLOURS | st.lists(COLOURS, min_size=4, max_size=4)
FILLED = st.builds(
    Paint,
    fill=FILLS,
    stroke=COLOURS | st.none(),
    width=SIZES,
    cap=st.sampled_from(["butt", "round", "square"]),
    join=st.sampled_from(["miter", "round", "bevel"]),
    rule=st.sampled_from(["nonzero", "evenodd"]),
)
STROKED = st.builds(Paint, fill=st.none(), stroke=COLOURS, width=SIZES)
PAINTS = FILLED | STROKED


@st.composite
def outlines(draw: Any) -> Outline:
    """Draw an outline of one to four curves."""
    degrees = tuple(draw(st.lists(st.integers(1, 3), min_size=1, max_size=4)))
    closed = draw(st.booleans()) and sum(degrees) > 1
    count = sum(degrees) + (not closed)
    points = draw(st.lists(POINTS, min_size=count, max_size=count, unique=True))
    return Outline(points, degrees, closed)


SHAPES = st.one_of(
    st.builds(Circle, POINTS, SIZES, PAINTS),
    st.builds(Ellipse, POINTS, st.tuples(SIZES, SIZES), PAINTS, st.floats(-179.0, 179.0)),
    st.builds(
        lambda centre, size, paint, rounding, angle: Rectangle(centre, size, paint, rounding * 0.5 * min(size), angle),
        POINTS,
        st.tuples(SIZES, SIZES),
        PAINTS,
        st.floats(0.0, 1.0),
        st.floats(-179.0, 179.0),
    ),
    st.builds(
        lambda subpaths, paint: Path(tuple(subpaths), paint), st.lists(outlines(), min_size=1, max_size=3), PAINTS
    ),
)


def numbers(shape: Any) -> np.ndarray[Any, Any]:
    """Return all numbers of a shape in one array."""
    paint = shape.paint
    values = [colour for colour in (paint.fill, paint.stroke) if colour is not None]
    values += [paint.width] if paint.stroke is not None else []
    if isinstance(shape, Path):
        values += [outline.points for outline in shape.outlines]
    else:
        values += [getattr(shape, key) for key in shape.__dataclass_fields__ if key != "paint"]
    return np.concatenate([np.ravel(np.asarray(value, dtype=np.float64)) for value in values])


@given(shapes=st.lists(SHAPES, min_size=1, max_size=4), background=st.tuples(*[st.floats(0.0, 1.0)] * 3))
def test_written_shapes_are_equal_when_read(shapes: Any, background: Any, tmp_path_factory: Any) -> None:
    file = tmp_path_factory.mktemp("svg") / "shapes.svg"
    write_svg(file, shapes, 60, 80, background)
    graphic = read_svg(file, 60, 80)
    assert [type(shape) for shape in graphic.shapes] == [type(shape) for shape in shapes]
    np.testing.assert_allclose(graphic.background, background, rtol=0, atol=1e-10)
    for actual, expected in zip(graphic.shapes, shapes, strict=True):
        if isinstance(expected, Path):
            assert isinstance(actual, Path)
            assert [(outline.degrees, outline.closed) for outline in actual.outlines] == [
                (outline.degrees, outline.closed) for outline in expected.outlines
            ]
        if expected.paint.stroke is not None:
            assert (actual.paint.cap, actual.paint.join) == (expected.paint.cap, expected.paint.join)
        assert actual.paint.rule == expected.paint.rule or expected.paint.fill is None
        np.testing.assert_allclose(numbers(actual), numbers(expected), rtol=1e-9, atol=1e-9)


def drawing(tmp_path: File, body: str, root: str = 'viewBox="0 0 16 16"') -> File:
    """Write an SVG file with a body, and return its path."""
    file = tmp_path / "drawing.svg"
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {root}>{body}</svg>')
    return file


def image(file: File, size: int = 16) -> np.ndarray[Any, Any]:
    renderer = Vector(size, size, svg=file)
    pixels: np.ndarray[Any, Any] = renderer.render(renderer.parameters()).numpy()
    return pixels


@pytest.mark.parametrize(
    ("body", "equivalent_body"),
    [
        ('<rect x="3" y="4" width="8" height="5"/>', '<path d="M3 4h8v5h-8z"/>'),
        ('<rect x="3" y="4" width="8" height="5"/>', '<polygon points="3,4 11,4 11,9 3,9"/>'),
        ('<circle cx="7" cy="8" r="4"/>', '<path d="M3 8a4 4 0 0 1 8 0a4 4 0 0 1 -8 0z"/>'),
        ('<circle cx="7" cy="8" r="4"/>', '<g transform="translate(7 8)"><circle r="2" transform="scale(2)"/></g>'),
        (
            '<rect x="2" y="4" width="6" height="3" transform="rotate(20 5 5)"/>',
            '<g transform="rotate(20 5 5)"><path d="M2 4H8V7H2Z"/></g>',
        ),
        (
            '<rect x="4" y="4" width="6" height="3" transform="skewX(20)"/>',
            '<path d="M4 4H10V7H4Z" transform="skewX(20)"/>',
        ),
        ('<circle cx="7" cy="8" r="4" fill="#f00"/>', '<g style="fill: red"><circle cx="7" cy="8" r="4"/></g>'),
        ('<circle cx="7" cy="8" r="4" opacity=".5"/>', '<circle cx="7" cy="8" r="4" fill-opacity="50%"/>'),
        ('<path d="M2 2Q9 14 14 3"/>', '<path d="M2 2C6.666666666666 10 10.666666666666 10.333333333333 14 3"/>'),
        ('<line x1="2" y1="3" x2="9" y2="4" stroke="blue"/>', '<path d="M2 3L9 4" fill="none" stroke="rgb(0,0,255)"/>'),
    ],
)
def test_equivalent_svg_elements_have_equal_images(tmp_path: File, body: str, equivalent_body: str) -> None:
    expected = image(drawing(tmp_path, body))
    assert np.ptp(expected) > 0.4
    # Cubic curves have an error of 3e-4 of an arc's radius, and chords an error of 0.01 px.
    np.testing.assert_allclose(expected, image(drawing(tmp_path, equivalent_body)), rtol=0, atol=0.02)


def test_the_svg_view_box_is_fitted_into_the_image_and_centred(tmp_path: File) -> None:
    file = drawing(tmp_path, '<circle cx="15" cy="10" r="5"/>', 'viewBox="10 5 10 5"')
    (circle,) = read_svg(file, 40, 40).shapes
    assert isinstance(circle, Circle)
    np.testing.assert_allclose([*circle.centre, circle.radius], [20.0, 30.0, 20.0])


def test_a_scene_file_names_an_svg_relative_to_its_folder(tmp_path: File) -> None:
    np.save(tmp_path / "target.npy", image(drawing(tmp_path, '<circle cx="7" cy="8" r="4"/>')))
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'target = "target.npy"\n[renderer]\nname = "vector-torch"\nsvg = "drawing.svg"\n'
        "[optimise.positions]\ninitial = [[3.0, 4.0]]\ntruth = [[7.0, 8.0]]\n"
    )
    assert isinstance(load_scene(scene).renderer, Vector)


CIRCLE = '<circle cx="7" cy="8" r="4"/>'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<svg", "not well-formed XML"),
        ('<?xml version="1.0" encoding="utf-9"?><svg/>', "not well-formed XML (LookupError: unknown encoding: utf-9)"),
        ('<?xml version="1.0" encoding="big5"?><svg/>', "multi-byte encodings are not supported"),
        ("<svg></svg>", "there is no shape in it"),
        ("<html><p/></html>", "<html> is not supported here"),
        (f"<svg><svg>{CIRCLE}</svg></svg>", "<svg> is not supported here"),
        ('<svg><text x="1">a</text></svg>', "<text> is not supported here; known are svg (once, outermost), g, path"),
        ('<svg><image href="file:///etc/passwd"/></svg>', "<image> is not supported here"),
        ('<svg><use href="#a"/></svg>', "<use> is not supported here"),
        ("<svg><style>circle { fill: red }</style></svg>", "<style> is not supported here"),
        ('<svg><circle r="4" fill="url(#a)"/></svg>', "<circle>: `fill` must be none, #rgb"),
        ('<svg><circle r="4" stroke-dasharray="1 2"/></svg>', "<circle>: `stroke-dasharray` = '1 2' is not supported"),
        ('<svg><circle r="4" filter="url(#b)"/></svg>', "<circle>: `filter` = 'url(#b)' is not supported"),
        ('<svg><circle r="4mm"/></svg>', "<circle>: `r` must be a number up to 1e+09, alone or in px, got '4mm'"),
        ('<svg><circle r="nan"/></svg>', "`r` must be a number"),
        ('<svg><circle r="1e10"/></svg>', "`r` must be a number up to 1e+09"),
        ('<svg><path d="M1e999 0L1 1"/></svg>', "`points` must be finite"),
        ('<svg><circle r="4" transform="scale(1e99)"/></svg>', "<circle>: `transform` must stay within 1e+09"),
        (f'<svg><g transform="scale(1e8)"><g transform="scale(99)">{CIRCLE}</g></g></svg>', "all transforms together"),
        ('<svg><circle r="-4"/></svg>', "<circle>: `r` must be 0 or more, got -4.0"),
        ('<svg><circle r="-4" transform="skewX(9)"/></svg>', "<circle>: `r` must be 0 or more, got -4.0"),
        ('<svg><ellipse rx="4" ry="-1"/></svg>', "<ellipse>: `ry` must be 0 or more, got -1.0"),
        ('<svg><rect width="4" height="4" rx="-1"/></svg>', "<rect>: `rx` must be 0 or more, got -1.0"),
        ('<svg><path d="M0 0 L1 1 X 2"/></svg>', "<path>: `d` must be commands and numbers, begun with M"),
        ('<svg><path d="L1 1 2 3"/></svg>', "<path>: `d` must be commands and numbers, begun with M"),
        ('<svg><path d="M0 0 L1 1 2"/></svg>', "<path>: 'd' cannot be read"),
        ('<svg><polygon points="0 0 1"/></svg>', "<polygon>: `points` must be pairs of numbers, got 3 numbers"),
        ('<svg><polygon points="0,,0 1 1"/></svg>', "<polygon>: `points` must be numbers, got '0,,0 1 1'"),
        ('<svg><path d="M0 0L1 1 2. 2"/></svg>', "<path>: `d` must be commands and numbers, begun with M"),
        ('<svg width="9em"><rect width="3" height="3"/></svg>', "alone or in px, mm, cm, in, pt, pc, got '9em'"),
        (f"<svg><rect>{CIRCLE}</rect></svg>", "<circle> in a <rect> is not supported; SVG does not show it"),
        (f"<svg>{CIRCLE}<g display='none'><style>a</style></g></svg>", "<style> is not supported here"),
        (f'<svg display="none">{CIRCLE}</svg>', "<svg>: `display` = 'none' is not supported"),
        (f'<svg style="background-color: #fff8">{CIRCLE}</svg>', "`background-color` must be opaque, got '#fff8'"),
        ('<svg viewBox="0 0 0 1"></svg>', "`viewBox` must be four numbers"),
        ('<svg viewBox="1"></svg>', "`viewBox` must be four numbers"),
        (f'<svg><g opacity="0.5">{CIRCLE}</g></svg>', "<g> with an `opacity` is not supported"),
        ('<svg><circle r="4" stroke="red" transform="scale(1 2)"/></svg>', "not a similarity"),
        ('<!DOCTYPE svg [<!ENTITY a "b">]><svg>&a;</svg>', "document type declaration"),
        ("<svg>" + 70 * "<g>" + 70 * "</g>" + "</svg>", "more than 64 deep"),
        ('<svg width="0"><rect width="3" height="3"/></svg>', "`width` and `height` must be more than 0, got [0.0, "),
        (f'<svg><path d="M0 0{" L1 1" * 60_000}"/></svg>', "more than 200000 points"),
        ("<svg>" + " " * 2**23 + "</svg>", "larger than 8388608 bytes"),
    ],
)
def test_unsupported_svg_content_is_named_in_one_line(tmp_path: File, content: str, message: str) -> None:
    file = tmp_path / "bad.svg"
    file.write_text(content)
    with pytest.raises(SvgError) as caught:
        read_svg(file, 8, 8)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith(str(file))


INKSCAPE = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<!-- Created with Inkscape (http://www.inkscape.org/) -->
<svg width="210mm" height="297mm" viewBox="0 0 210 297" version="1.1" id="svg5" inkscape:version="1.3.2"
   xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" xmlns:xlink="http://www.w3.org/1999/xlink"
   xmlns:sodipodi="http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd" xmlns="http://www.w3.org/2000/svg">
  <sodipodi:namedview id="view" pagecolor="#ffffff"><inkscape:grid type="xygrid" id="grid1" /></sodipodi:namedview>
  <defs id="defs2">
    <linearGradient inkscape:collect="always" id="ramp"><stop style="stop-color:#f00;stop-opacity:1" /></linearGradient>
    <clipPath clipPathUnits="userSpaceOnUse" id="clip"><rect width="10" height="10" id="rect9" /></clipPath>
  </defs>
  <g inkscape:label="Layer 1" inkscape:groupmode="layer" id="layer1" transform="translate(3.5,-2)">
    <path style="line-height:normal;letter-spacing:normal;direction:ltr;dominant-baseline:auto;shape-padding:0;
      clip-rule:nonzero;isolation:auto;mix-blend-mode:normal;color-interpolation-filters:linearRGB;solid-color:#000;
      vector-effect:none;fill:#00f;marker:none;image-rendering:auto" d="m 9,9 c 10,20 30,20 40,0 z" id="path33" />
    EXTRA
  </g>
</svg>"""
FIGMA = """<svg width="24" height="24" viewBox="0 0 24 24" fill="none" xmlns="http://www.w3.org/2000/svg">
<path fill-rule="evenodd" clip-rule="evenodd" d="M12 2C6.48 2 2 6.48 2 12C2 17.52 6.48 22 12 22Z" fill="#1E1E1E"/>
EXTRA
<defs>
<radialGradient id="paint0" cx="0" cy="0" r="1" gradientUnits="userSpaceOnUse"><stop stop-color="red"/></radialGradient>
<clipPath id="clip0"><rect width="24" height="24" fill="white"/></clipPath>
<filter id="filter0" x="0" y="0" width="24" height="24"><feFlood flood-opacity="0"/></filter>
</defs>
</svg>"""


@pytest.mark.parametrize("content", [INKSCAPE, FIGMA])
@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ("", None),
        ('<symbol id="s"><circle r="4"/></symbol>', None),
        ('<rect width="9" height="9" fill="url(#paint0)"/>', "<rect>: `fill` must be none, #rgb, "),
        ('<path d="M0 0h9" stroke="url(#ramp)"/>', "rgb(...) or a name, got 'url(#ramp)', a gradient or a pattern"),
        ('<g clip-path="url(#clip0)"></g>', "<g>: `clip-path` = 'url(#clip0)' is not supported"),
        ('<g filter="url(#filter0)"></g>', "<g>: `filter` = 'url(#filter0)' is not supported"),
        ('<mask id="m"><circle r="4"/></mask><g mask="url(#m)"></g>', "<g>: `mask` = 'url(#m)' is not supported"),
        ('<use href="#path33"/>', "<use> is not supported here"),
        ('<use xlink:href="#path33" xmlns:xlink="http://www.w3.org/1999/xlink"/>', "<use> is not supported here"),
        ("<defs><style>.a { fill: red }</style></defs>", "<style> is not supported here"),
    ],
)
def test_definitions_of_inkscape_and_figma_are_skipped_and_references_are_refused(
    tmp_path: File, content: str, extra: str, message: str | None
) -> None:
    file = tmp_path / "drawing.svg"
    file.write_text(content.replace("EXTRA", extra))
    if message is None:
        (shape,) = read_svg(file, 24, 24).shapes
        assert isinstance(shape, Path)
    else:
        with pytest.raises(SvgError) as caught:
            read_svg(file, 24, 24)
        assert message in str(caught.value)


def test_a_missing_svg_file_is_named_in_the_error(tmp_path: File) -> None:
    with pytest.raises(SvgError, match=r"none\.svg: cannot be read"):
        Vector(8, 8, svg=tmp_path / "none.svg")


def test_the_time_to_read_arcs_is_linear_in_their_number(tmp_path: File) -> None:
    # Replacing each arc in the whole path would take twenty seconds and a hundred million calls.
    arcs = "".join(f"A5 5 0 0 1 {number % 90} {number % 70}" for number in range(8000))
    path = f'<path d="M0 0{arcs}" stroke="red" fill="none"/>'
    (tmp_path / "a.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg" width="96" height="96">{path}</svg>')
    calls = 0

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        read_svg(tmp_path / "a.svg", 96, 96)
    finally:
        sys.setprofile(None)
    assert calls < 8000 * 2000


@pytest.mark.parametrize(
    ("path", "message"), [("M0 0L1 1" + "Z" * 100000, ""), ("M0 0" + "L1 1Z" * 5000, "closed parts")]
)
def test_repeated_closings_are_merged_and_many_closed_subpaths_are_refused(
    path: str, message: str, tmp_path: File
) -> None:
    (tmp_path / "a.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><path d="{path}"/></svg>'
    )
    if message:
        with pytest.raises(SvgError, match=message):
            read_svg(tmp_path / "a.svg", 9, 9)
    else:
        assert len(read_svg(tmp_path / "a.svg", 9, 9).shapes) == 1


def white_pixels(tmp_path: File, body: str, root: str = 'viewBox="0 0 96 96"') -> float:
    """Return the white area on a black background of 96 x 96 pixels, rounded to 8 digits."""
    background = '<rect width="96" height="96"/>'
    return round(float(image(drawing(tmp_path, background + body, root), 96).mean(axis=-1).sum()), 8)


def refusal(tmp_path: File, body: str) -> str:
    """Return the message of the error that reading an SVG file with a body raises."""
    with pytest.raises(SvgError) as caught:
        read_svg(drawing(tmp_path, body), 96, 96)
    return str(caught.value)


@pytest.mark.parametrize(
    ("smooth", "explicit"),
    [
        # S and T reflect the control point of a preceding curve of the same degree. After another segment, their
        # control point is the start of the curve.
        ("M10 50Q20 10 40 40S80 90 86 50", "M10 50Q20 10 40 40C40 40 80 90 86 50"),
        ("M10 50T40 20S60 60 86 50", "M10 50L40 20C40 20 60 60 86 50"),
        ("M10 50C20 10 40 10 48 50T86 50", "M10 50C20 10 40 10 48 50L86 50"),
        ("M10 50S40 10 48 50T86 50", "M10 50C10 50 40 10 48 50L86 50"),
        ("M10 50A20 20 0 0 1 40 40S80 90 86 50", "M10 50A20 20 0 0 1 40 40C40 40 80 90 86 50"),
        ("M10 50A20 20 0 0 1 40 40T86 50", "M10 50A20 20 0 0 1 40 40L86 50"),
        ("M10 50L40 40S80 90 86 50", "M10 50L40 40C40 40 80 90 86 50"),
        ("M10 50q10 -40 30 -10s40 50 46 10", "M10 50Q20 10 40 40C40 40 80 90 86 50"),
        ("M10 50c10 -40 30 -40 38 0t38 10", "M10 50C20 10 40 10 48 50L86 60"),
        ("M10 50C20 10 40 10 48 50S80 90 86 50", "M10 50C20 10 40 10 48 50C56 90 80 90 86 50"),
        ("M10 50Q20 10 40 40T86 50", "M10 50Q20 10 40 40Q60 70 86 50"),
        ("M10 50C20 10 40 10 48 50T60 50T86 60", "M10 50C20 10 40 10 48 50L60 50Q72 50 86 60"),
    ],
)
def test_smooth_curves_continue_preceding_curves_of_their_degree(tmp_path: File, smooth: str, explicit: str) -> None:
    bodies = [f'<path d="{path}V90H10z" fill="white"/>' for path in (smooth, explicit)]
    # A straight curve and a line have different chords, so the test compares areas.
    assert white_pixels(tmp_path, bodies[0]) == pytest.approx(white_pixels(tmp_path, bodies[1]), abs=1e-7)


@pytest.mark.parametrize("radii", ["0 0", "0 7", "7 0", "-0 5"])
def test_arcs_with_a_radius_of_zero_are_lines(tmp_path: File, radii: str) -> None:
    path = f"M20 20h40v40A{radii} 30 0 1 20 60a{radii} 0 1 0 0 -40z"
    assert white_pixels(tmp_path, f'<path d="{path}" fill="white"/>') == pytest.approx(1600.0)


@pytest.mark.parametrize("radius", ["20", "5", "1e-6", "1e-200", "-1e-9"])
def test_arcs_with_radii_too_small_for_their_ends_become_half_circles(tmp_path: File, radius: str) -> None:
    area = white_pixels(tmp_path, f'<path d="M20 40A{radius} {radius} 0 0 1 60 40z" fill="white"/>')
    assert area == pytest.approx(200.0 * np.pi, rel=2e-3)  # chords are within 0.01 px of the arc


@pytest.mark.parametrize("scale", [1e-9, 0.5, 2.0])
def test_enlarged_arcs_keep_the_aspect_ratio_of_their_radii(tmp_path: File, scale: float) -> None:
    radii = f"{3.0 * scale} {2.0 * scale}"
    bodies = [f'<path d="M20 40A{pair} 30 0 1 60 50z" fill="white"/>' for pair in (radii, "3 2")]
    assert white_pixels(tmp_path, bodies[0]) == pytest.approx(white_pixels(tmp_path, bodies[1]), abs=1e-6)


@pytest.mark.parametrize(
    ("path", "length"),
    [
        *(("M48 48h0", 0), ("M48 48L48 48", 0), ("M48 48z", 0), ("M48 48c0 0 0 0 0 0z", 0)),
        *(("M9 9h9M48 48h0", 9), ("M48 48v0M9 9h9", 9), ("M9 9h9l-9 0zl0 0", 18)),
    ],
)
def test_subpaths_without_length_are_refused_with_round_and_square_caps(tmp_path: File, path: str, length: int) -> None:
    stroke = 'fill="none" stroke="white" stroke-width="12"'
    for cap in ("round", "square"):
        message = refusal(tmp_path, f'<path d="{path}" {stroke} stroke-linecap="{cap}"/>')
        assert f"<path>: a part without length, of which a {cap} cap makes a dot, is not supported" in message
    if length < 18:  # the stroke of the longest path overlaps itself
        assert white_pixels(tmp_path, f'<path d="{path}" {stroke}/>') == pytest.approx(12.0 * length)
    assert white_pixels(tmp_path, f'<path d="{path}" fill="white" stroke-linecap="round"/>') == 0.0


def test_moves_without_a_line_draw_no_dot(tmp_path: File) -> None:
    stroke = 'stroke="white" stroke-width="4" stroke-linecap="square"'
    for path in ("M48 48", "M9 9M48 48", "M48 48M20 20h9M5 5"):
        assert white_pixels(tmp_path, f'<path d="{path}" {stroke}/>') == pytest.approx(52.0 * ("h9" in path))


@pytest.mark.parametrize(
    "shape",
    ['rect width="0" height="9"', 'rect width="9"', 'circle r="0"', "circle", 'ellipse rx="0" ry="9"', "ellipse"],
)
@pytest.mark.parametrize("transform", ["", 'transform="translate(9 9) rotate(8)"'])
def test_shapes_without_extent_draw_nothing(tmp_path: File, shape: str, transform: str) -> None:
    assert white_pixels(tmp_path, f'<{shape} {transform} fill="red" stroke="white" stroke-width="8"/>') == 0.0


@pytest.mark.parametrize("radii", ['rx="20"', 'ry="20"', 'rx="auto" ry="20"', 'rx="20" ry="auto"', 'rx="20" ry="20"'])
@pytest.mark.parametrize("transform", ["", 'transform="translate(9 -5) skewX(10)"'])
def test_an_ellipse_with_a_single_radius_is_a_circle(tmp_path: File, radii: str, transform: str) -> None:
    area = white_pixels(tmp_path, f'<ellipse cx="48" cy="50" {radii} {transform} fill="white"/>')
    assert area == pytest.approx(400.0 * np.pi, rel=1e-3)


@given(values=st.tuples(*[st.floats(-2.0, 3.0)] * 2), alpha=st.floats(-1.0, 2.0))
def test_opacities_are_clipped_to_0_and_1_before_their_product(
    values: Any, alpha: float, tmp_path_factory: Any
) -> None:
    opacity, paint_opacity = values
    for key in ("fill", "stroke"):
        painted = f'{key}="rgb(255 255 255 / {alpha})" {key}-opacity="{paint_opacity}" opacity="{opacity}"'
        body = f'<g fill="none"><path d="M0 0h9v9" {painted}/></g>'
        (shape,) = read_svg(drawing(tmp_path_factory.mktemp("svg"), body), 16, 16).shapes
        assert getattr(shape.paint, key)[3] == pytest.approx(
            np.prod(np.clip([opacity, paint_opacity, alpha], 0.0, 1.0))
        )


@pytest.mark.parametrize(
    ("transform", "equivalent_transform"),
    [
        ("translate(9px, 4px)", "translate(9 4)"),
        ("translate(1in)", "translate(96)"),
        ("translateX(9)translateY(4px)", "translate(9,4)"),
        ("scaleX(2) scaleY(.5)", "scale(2 0.5)"),
        ("scale(1.5)", "matrix(1.5 0 0 1.5 0 0)"),
        ("translate(10-5)", "translate(10,-5)"),
        ("translate(10.5.5)", "translate(10.5 0.5)"),
        ("rotate(30deg)", "rotate(30)"),
        ("rotate(0.125turn)", "rotate(50grad)"),
        ("rotate(20 5 7)", "translate(5 7) rotate(20) translate(-5 -7)"),
        ("skewX(20)", "matrix(1 0 0.36397023426620234 1 0 0)"),
        ("skewY(20)", "skew(0deg, 20deg)"),
        (" translate(9)\n, scale(2) ", "translate(9 0)scale(2 2)"),
        ("none", ""),
    ],
)
def test_equivalent_svg_transforms_move_points_equally(
    tmp_path: File, transform: str, equivalent_transform: str
) -> None:
    paths = []
    for text in (transform, equivalent_transform):
        (path,) = read_svg(drawing(tmp_path, f'<path d="M0 0h9v9z" transform="{text}"/>'), 16, 16).shapes
        assert isinstance(path, Path)
        paths.append(path.outlines[0].points)
    np.testing.assert_allclose(paths[0], paths[1], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    "transform",
    [
        *("translate3d(9px,0,0)", "rotateZ(30deg)", "foo(3)", "translate(9) rubbish(3)", "translate(9) rubbish"),
        *("Translate(9)", "SCALE(2)", "skewx(3)", "rotate(30 20)", "rotate()", "translate(1 2 3)", "scale(1 2 3)"),
        *("matrix(1 0 0 1 5)", "matrix(1 0 0 1 5 6 7)", "translate(9,)", "translate(,9)", "translate(9,,9)"),
        *("translate 9", "scale(2),", ",scale(2)", "none scale(2)", "translate(9em)"),
        *(
            "scale(2px)",
            "rotate(3px)",
            "translate(50%)",
            "scale(2",
            "scale(2))",
            "scale((2))",
            "skewX(1 2)",
            "translate",
        ),
    ],
)
def test_invalid_svg_transforms_are_refused(tmp_path: File, transform: str) -> None:
    for attribute in (f'transform="{transform}"', f'style="fill: red; transform: {transform}"'):
        assert "<rect>: `transform` = " in refusal(tmp_path, f'<rect width="9" height="9" {attribute}/>')


@pytest.mark.parametrize(
    "text", ["10-10 80,20 50 60", "10,-10,80,20,50,60", "1e1-10+80 20.0 50 6e1", " 10-10\n80 20 50,60"]
)
def test_svg_points_are_read_with_any_separators(tmp_path: File, text: str) -> None:
    for tag, closed in (("polygon", True), ("polyline", False)):
        (path,) = read_svg(drawing(tmp_path, f'<{tag} points="{text}"/>', 'width="9" height="9"'), 9, 9).shapes
        assert isinstance(path, Path)
        np.testing.assert_array_equal(path.outlines[0].points, [[10, -10], [80, 20], [50, 60]])
        assert path.outlines[0].closed == closed


@pytest.mark.parametrize(
    ("colour", "equivalent_colour"),
    [
        ("#f00", "rgb(255,0,0)"),
        ("Red", "#ff0000"),
        ("AliceBlue", "#f0f8ff"),
        ("rebeccapurple", "#663399"),
        ("#f008", "rgb(255 0 0 / 53.333333333333336%)"),
        ("#ff000080", "rgba(255, 0, 0, 0.50196078431372548)"),
        ("rgb(1 2 3)", "rgb(1,2,3)"),
        ("rgb(1 2 3 / .5)", "rgba(1, 2, 3, 50%)"),
        ("RGB(10%, 20%, 30%)", "rgb(10% 20% 30%)"),
        ("currentColor", "#123456"),
        ("CURRENTCOLOR", "#123456"),
    ],
)
def test_equivalent_svg_colours_give_equal_paints(tmp_path: File, colour: str, equivalent_colour: str) -> None:
    texts = (colour, equivalent_colour)
    bodies = [f'<g color="#123456"><circle r="9" color="inherit" fill="{text}"/></g>' for text in texts]
    fill, equivalent_fill = (read_svg(drawing(tmp_path, body), 16, 16).shapes[0].paint.fill for body in bodies)
    np.testing.assert_allclose(np.array(fill), np.array(equivalent_fill), rtol=0.0, atol=1e-15)


def test_current_color_is_the_colour_of_the_painted_element(tmp_path: File) -> None:
    body = '<g color="red" fill="currentColor"><circle r="9" color="white"/><circle r="9"/></g><circle r="9"/>'
    fills = [shape.paint.fill for shape in read_svg(drawing(tmp_path, body), 16, 16).shapes]
    np.testing.assert_array_equal(np.array(fills), [[1, 1, 1, 1], [1, 0, 0, 1], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    "text",
    [
        *("colour", "initial", "unset", "revert", "random", "AccentColor", "Window", "context-fill", "", "wh ite"),
        *("#12", "#12345", "#1234567", "rgb(1,2)", "rgb(1 2 3 .5)", "rgb(1,2,3 / .5)", "rgb(1, 2 3)", "rgb(1 2 3"),
        "rgb(50%,1,2)",
    ],
)
def test_invalid_svg_colours_are_refused(tmp_path: File, text: str) -> None:
    for key in ("fill", "stroke"):
        message = refusal(tmp_path, f'<g fill="white"><rect width="9" height="9" {key}="{text}"/></g>')
        assert f"<rect>: `{key}` must be none, #rgb, #rrggbb, rgb(...) or a name, got '{text}'" in message
    assert "`fill` must be" in refusal(tmp_path, f'<circle r="9" color="{text}" fill="currentColor"/>')


@pytest.mark.parametrize("text", ["none", "NONE", "Transparent", "transparent"])
def test_none_and_transparent_paints_draw_nothing_in_upper_or_lower_case(tmp_path: File, text: str) -> None:
    body = f'<g fill="white" stroke="white"><rect width="50" height="50" fill="{text}" stroke="{text}"/></g>'
    assert white_pixels(tmp_path, body) == 0.0


@pytest.mark.parametrize(
    "attributes",
    [
        *(
            'style="-inkscape-stroke:none;-inkscape-font-specification:Sans"',
            'style="color:#000000"',
            'color="rubbish"',
        ),
        *(
            'clip-path="none"',
            'mask="none"',
            'filter="none"',
            'stroke-miterlimit="10"',
            'style="fill:white !important"',
        ),
        *(
            'style="fill:white!important;fill:red"',
            'style="/* fill:red; */fill:white/* ;fill:red"',
            'fill="rgb(255 255 255)"',
        ),
        *('stroke="white" stroke-width="0" stroke-miterlimit="10"', 'stroke="none" style="stroke-miterlimit:10"'),
        *('style="/* a */ /* b */"', 'fill="rgba(255, 255, 255, 1)"', 'opacity="7.0"', 'display="inline"'),
    ],
)
def test_svg_attributes_without_effect_are_accepted(tmp_path: File, attributes: str) -> None:
    fill = "" if "fill=" in attributes else 'fill="white"'
    assert white_pixels(tmp_path, f'<path d="M3 3h50v50h-50z" {fill} {attributes}/>') == pytest.approx(2500.0)
    assert white_pixels(tmp_path, f'<g {fill} {attributes}><path d="M3 3h50v50h-50z"/></g>') == pytest.approx(2500.0)


def test_svg_elements_that_are_not_displayed_are_not_read(tmp_path: File) -> None:
    hidden = '<text>a</text><rect width="9" height="9" fill="url(#a)"/><g display="inline"><circle r="9"/></g>'
    for attributes in (
        'display="none"',
        'style="display: none"',
        'display="inline" style="display:none" filter="url(#b)"',
    ):
        undisplayed = f'<g {attributes}>{hidden}</g><rect width="50" height="50" {attributes}/>'
        assert white_pixels(tmp_path, undisplayed + '<rect width="3" height="3" fill="white"/>') == pytest.approx(9.0)


def test_a_miter_limit_is_refused_only_for_strokes_with_miters(tmp_path: File) -> None:
    stroke = 'stroke="white" stroke-width="4" stroke-miterlimit="10" fill="none"'
    path = 'path d="M10 80L48 20L86 80"'
    assert "<path>: `stroke-miterlimit` = '10' is not supported" in refusal(tmp_path, f"<{path} {stroke}/>")
    assert "`stroke-miterlimit` = '10'" in refusal(tmp_path, f"<g {stroke}><{path}/></g>")
    assert "`stroke-miterlimit` = '1'" in refusal(tmp_path, f'<rect width="9" height="9" {stroke.replace("10", "1")}/>')
    for element in (
        *(f'{path} stroke-linejoin="round"', f'{path} stroke-linejoin="bevel"', 'circle cx="48" cy="48" r="9"'),
        *('line x2="50" y2="50"', 'ellipse cx="48" cy="48" rx="9"', 'rect x="9" y="9" width="30" height="20"'),
    ):
        strokes = (stroke, stroke.replace('"10"', '"4.0"'))  # 4 is the default
        area, default_area = (white_pixels(tmp_path, f"<{element} {attributes}/>") for attributes in strokes)
        assert area == default_area > 0.0


@pytest.mark.parametrize("size", ["25.4mm", "2.54cm", "1in", "72pt", "6pc", "96px", "96"])
def test_an_inch_has_96_svg_pixels_without_a_view_box(tmp_path: File, size: str) -> None:
    body = '<rect x="30" y="10" width="60" height="50"/>'
    (rectangle,) = read_svg(drawing(tmp_path, body, f'width="{size}" height="{size}"'), 48, 48).shapes
    assert isinstance(rectangle, Rectangle)
    np.testing.assert_allclose([*rectangle.centre, *rectangle.sides], [30.0, 17.5, 30.0, 25.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("path", "degrees"),
    [
        ("M10 10C90 10 10 90 10 10z", (3,)),
        ("M10 10C90 10 10 90 10 10", None),
        ("M10 10Q50 10 50 50Q10 50 10 10z", (2, 2)),
        ("M10 10L50 10L50 50L10 10z", (1, 1, 1)),
        ("M10 10L50 10L50 50z", (1, 1, 1)),
        ("M10 10C10 90 90 90 90 10z", (3, 1)),
    ],
)
def test_a_closed_curve_that_returns_to_its_start_has_no_closing_line(
    tmp_path: File, path: str, degrees: tuple[int, ...] | None
) -> None:
    (shape,) = read_svg(drawing(tmp_path, f'<path d="{path}"/>'), 16, 16).shapes
    assert isinstance(shape, Path)
    (outline,) = shape.outlines
    assert (outline.degrees, outline.closed) == (degrees or (3,), degrees is not None)


@pytest.mark.parametrize(
    "body",
    [
        "<circle r='1' style='{}'/>".format("/*" * 200_000),
        f"<circle r='1' transform='scale({'1' * 400_000}'/>",
        f"<circle r='1' transform='{'scale(1)' * 50_000}!'/>",
        f"<circle r='1' transform='scale({' ' * 400_000}'/>",
        f"<circle r='1' fill='rgb({' ' * 400_000}'/>",
        f"<circle r='1' fill='rgb({'1' * 400_000}'/>",
        f"<polygon points='{'1' * 400_000}!'/>",
        f"<polygon points='{'1, ' * 100_000}!'/>",
        f"<path d='M0 0{'s1 1 2 2t3 3' * 20_000}!'/>",
        f"<path d='M0 0{'1' * 400_000}!'/>",
    ],
)
def test_the_time_to_read_an_svg_is_linear_in_its_length(tmp_path: File, body: str) -> None:
    # A regular expression that starts again at every character would take a minute or more for each body.
    start = time.process_time()
    with contextlib.suppress(SvgError):
        read_svg(drawing(tmp_path, body), 16, 16)
    assert time.process_time() - start < 10.0

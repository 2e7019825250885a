"""SVG is read and written without loss, and what is not supported is named in one line."""

from __future__ import annotations

import sys
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
    degrees = tuple(draw(st.lists(st.integers(1, 3), min_size=1, max_size=4)))
    closed = draw(st.booleans()) and degrees[-1] == 1 and len(degrees) > 1
    count = sum(degrees) + (not closed)
    points = draw(st.lists(POINTS, min_size=count, max_size=count, unique=True))
    return Outline(points, degrees, closed)


SHAPES = st.one_of(
    st.builds(Circle, POINTS, SIZES, PAINTS),
    st.builds(Ellipse, POINTS, st.tuples(SIZES, SIZES), PAINTS, st.floats(-179.0, 179.0)),
    st.builds(
        lambda centre, sides, paint, share, angle: Rectangle(centre, sides, paint, share * 0.5 * min(sides), angle),
        POINTS,
        st.tuples(SIZES, SIZES),
        PAINTS,
        st.floats(0.0, 1.0),
        st.floats(-179.0, 179.0),
    ),
    st.builds(lambda parts, paint: Path(tuple(parts), paint), st.lists(outlines(), min_size=1, max_size=3), PAINTS),
)


def numbers(shape: Any) -> np.ndarray[Any, Any]:
    """All numbers of a shape."""
    paint = shape.paint
    parts = [one for one in (paint.fill, paint.stroke) if one is not None]
    parts += [paint.width] if paint.stroke is not None else []
    if isinstance(shape, Path):
        parts += [one.points for one in shape.outlines]
    else:
        parts += [getattr(shape, key) for key in shape.__dataclass_fields__ if key != "paint"]
    return np.concatenate([np.ravel(np.asarray(one, dtype=np.float64)) for one in parts])


@given(shapes=st.lists(SHAPES, min_size=1, max_size=4), background=st.tuples(*[st.floats(0.0, 1.0)] * 3))
def test_what_was_written_is_read_again(shapes: Any, background: Any, tmp_path_factory: Any) -> None:
    file = tmp_path_factory.mktemp("svg") / "shapes.svg"
    write_svg(file, shapes, 60, 80, background)
    again = read_svg(file, 60, 80)
    assert [type(one) for one in again.shapes] == [type(one) for one in shapes]
    np.testing.assert_allclose(again.background, background, rtol=0, atol=1e-10)
    for got, wanted in zip(again.shapes, shapes, strict=True):
        if isinstance(wanted, Path):
            assert isinstance(got, Path)
            assert [(one.degrees, one.closed) for one in got.outlines] == [
                (one.degrees, one.closed) for one in wanted.outlines
            ]
        if wanted.paint.stroke is not None:
            assert (got.paint.cap, got.paint.join) == (wanted.paint.cap, wanted.paint.join)
        assert got.paint.rule == wanted.paint.rule or wanted.paint.fill is None
        np.testing.assert_allclose(numbers(got), numbers(wanted), rtol=1e-9, atol=1e-9)


def drawing(tmp_path: File, body: str, root: str = 'viewBox="0 0 16 16"') -> File:
    file = tmp_path / "drawing.svg"
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {root}>{body}</svg>')
    return file


def image(file: File, size: int = 16) -> np.ndarray[Any, Any]:
    made = Vector(size, size, svg=file)
    picture: np.ndarray[Any, Any] = made.render(made.parameters()).numpy()
    return picture


@pytest.mark.parametrize(
    ("one", "other"),
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
def test_two_ways_to_draw_the_same(tmp_path: File, one: str, other: str) -> None:
    first = image(drawing(tmp_path, one))
    assert np.ptp(first) > 0.4
    # Arcs become cubic curves, which are off by 3e-4 of the radius, and chords by 0.01 px.
    np.testing.assert_allclose(first, image(drawing(tmp_path, other)), rtol=0, atol=0.02)


def test_the_view_box_is_fitted_into_the_image_and_centred(tmp_path: File) -> None:
    file = drawing(tmp_path, '<circle cx="15" cy="10" r="5"/>', 'viewBox="10 5 10 5"')
    (circle,) = read_svg(file, 40, 40).shapes
    assert isinstance(circle, Circle)
    np.testing.assert_allclose([*circle.centre, circle.radius], [20.0, 30.0, 20.0])


def test_a_scene_file_names_its_svg_beside_it(tmp_path: File) -> None:
    np.save(tmp_path / "target.npy", image(drawing(tmp_path, '<circle cx="7" cy="8" r="4"/>')))
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'target = "target.npy"\n[renderer]\nname = "vector-torch"\nsvg = "drawing.svg"\n'
        "[optimise.positions]\ninitial = [[3.0, 4.0]]\ntruth = [[7.0, 8.0]]\n"
    )
    assert isinstance(load_scene(scene).renderer, Vector)


CIRCLE = '<circle cx="7" cy="8" r="4"/>'


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("<svg", "not well-formed XML"),
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
        ('<svg><circle r="-4"/></svg>', "`radius` must be 0 or more"),
        ('<svg><path d="M0 0 L1 1 X 2"/></svg>', "<path>: `d` must be commands and numbers, begun with M"),
        ('<svg><path d="L1 1 2 3"/></svg>', "<path>: `d` must be commands and numbers, begun with M"),
        ('<svg><path d="M0 0 L1 1 2"/></svg>', "<path>: 'd' cannot be read"),
        ('<svg><polygon points="0 0 1"/></svg>', "<polygon>: 'points' cannot be read"),
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
def test_what_is_not_supported_is_named(tmp_path: File, content: str, says: str) -> None:
    file = tmp_path / "bad.svg"
    file.write_text(content)
    with pytest.raises(SvgError) as caught:
        read_svg(file, 8, 8)
    assert says in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith(str(file))


def test_a_missing_file_is_named(tmp_path: File) -> None:
    with pytest.raises(SvgError, match=r"none\.svg: cannot be read"):
        Vector(8, 8, svg=tmp_path / "none.svg")


def test_time_grows_with_the_number_of_arcs_and_not_with_its_square(tmp_path: File) -> None:
    # Twenty seconds, and a hundred million calls, if each arc is replaced in the path that holds all.
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


@pytest.mark.parametrize(("path", "says"), [("M0 0L1 1" + "Z" * 100000, ""), ("M0 0" + "L1 1Z" * 5000, "closed parts")])
def test_closings_are_counted_where_the_library_goes_back_for_each(path: str, says: str, tmp_path: File) -> None:
    (tmp_path / "a.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><path d="{path}"/></svg>'
    )
    if says:
        with pytest.raises(SvgError, match=says):
            read_svg(tmp_path / "a.svg", 9, 9)
    else:
        assert len(read_svg(tmp_path / "a.svg", 9, 9).shapes) == 1

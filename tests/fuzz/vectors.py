"""SVG files: written ones that were damaged, and such where any element has any value."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from loi_core.support.arrays import to_numpy
from loi_torch.vector import Vector
from tests.fuzz.claims import Call
from tests.fuzz.damage import damaged

__all__ = ["damaged_svgs", "svg_values"]

WHOLE: Final = """\
<svg xmlns="http://www.w3.org/2000/svg" width="40" height="30" viewBox="0 0 40 30" style="background-color: #fed">
<title>All that is read</title>
<g fill="#08f" stroke="rgb(10%,20%,30%)" stroke-width="1.5" stroke-linejoin="round" transform="rotate(5) scale(0.9)">
<circle cx="8" cy="9" r="5"/><ellipse cx="20" cy="9" rx="6" ry="3" transform="translate(1,2)"/>
<rect x="3" y="16" width="9" height="8" rx="2" stroke="none" fill-opacity="50%"/>
<path d="M15 15 L25 15 q4 4 0 8 C 20 28 17 25 15 22 A 3 2 30 1 0 14 18 z M18 18h3v3h-3z" fill-rule="evenodd"/>
<line x1="30" y1="2" x2="38" y2="12" stroke-linecap="square"/>
<polyline points="30,14 34,20 38,14" fill="none"/><polygon points="28 24 38 24 33 29"/>
</g></svg>
"""
TAGS: Final = (
    "g",
    "path",
    "rect",
    "circle",
    "ellipse",
    "line",
    "polyline",
    "polygon",
    "title",
    "svg",
    "use",
    "text",
    "x:y",
)
GEOMETRY: Final = ("d", "x", "y", "width", "height", "rx", "ry", "cx", "cy", "r", "x1", "y1", "x2", "y2", "points")
STYLE: Final = (
    *("fill", "fill-opacity", "fill-rule", "stroke", "stroke-opacity", "stroke-width", "stroke-linecap"),
    *("stroke-linejoin", "opacity", "transform", "style", "display", "viewBox", "background-color", "data-loi-corners"),
    *("stroke-dasharray", "id", "class", "onload", "href", "mask", "filter", "xml:base"),
)
ROOT: Final = ("width", "height", "viewBox", "style", "background-color", "transform", "opacity", "fill", "x", "onload")
VALUES: Final = (
    *(
        "0",
        "1",
        "-1",
        "2.5",
        "7",
        "12",
        "1e3",
        "1e-9",
        "1e6",
        "1e300",
        "1e999",
        "-1e300",
        "nan",
        "inf",
        "0x10",
        "9" * 400,
    ),
    *("", " ", "50%", "-5%", "3px", "2em", "auto", "none", "inherit", "red", "#f00", "#12345", "rgb(1,2)", "url(#a)"),
    *(
        "rgb(300,-5,0)",
        "hsl(1,2%,3%)",
        "nonzero",
        "evenodd",
        "round",
        "miter",
        "transparent",
        "currentColor",
        "\x1b[2J",
    ),
    *(
        "M0 0L9 9",
        "M 1 1 h 5 v 5 z",
        "M0,0" + "l1,1" * 4000,
        "m1 1" * 900,
        "M 0 0 A 1 1 0 0 0 0 0",
        "M0 0A5 5 0 1 1 9 9",
    ),
    *(
        "M 1e300 0 L -1e300 1",
        "M0 0 C 1 1",
        "L 1 1",
        "M",
        "z",
        "M0 0 T 5 5 S 1 1 2 2",
        "M 0 0 A 0 0 0 0 0 5 5",
        "M0 0Lnan 1",
    ),
    *("1 1 5 5 2 9", "1 1 5", "1,1 1,1 1,1", "0 0 40 30", "0 0 0 0", "1 2 3", "0 0 1e300 1", "-5 -5 50 50"),
    *(
        "scale(0)",
        "rotate(30)",
        "skewX(20)",
        "matrix(1 0 0 1 5 5)",
        "matrix(1 2 2 4 0 0)",
        "translate(1e300)",
        "scale(2",
    ),
    *("rotate(1e999)", "scale(-1 1)", "scale(1e-300)", "fill:red;stroke:#0f0", "fill", ";;:", "a:b;" * 500),
    *(" ".join(["0.5"] * 16), " ".join(["2"] * 16), "\u202e", "é", "javascript:alert(1)", "file:///etc/passwd"),
)


def _painting(path: Path, content: bytes) -> Call:
    path.write_bytes(content)

    def paint() -> str:
        renderer = Vector(20, 24, svg=path)
        image, pullback = renderer.render_vjp(renderer.parameters())
        host = to_numpy(image)
        assert np.all((host >= -1e-9) & (host <= 1.0 + 1e-9))  # nor NaN
        slopes = pullback(image)
        assert all(np.all(np.isfinite(to_numpy(one))) for one in slopes.values())
        return "an image"

    return paint


def damaged_svgs(rng: random.Random, folder: Path) -> Call:
    """A file that has everything, damaged."""
    return _painting(folder / "drawing.svg", damaged(rng, WHOLE.encode(), 3))


def svg_values(rng: random.Random, folder: Path) -> Call:
    """A tree of elements with any attributes."""
    head = '<svg xmlns="http://www.w3.org/2000/svg"' + (_attributes(rng, ROOT) if rng.random() < 0.3 else "")
    if rng.random() < 0.05:
        head = '<!DOCTYPE svg [<!ENTITY a "b"><!ENTITY c "&a;&a;&a;">]>\n' + head
    deep = rng.choice((0, 0, 1, 3, 62, 63, 64, 3000))
    body = "".join(_element(rng) for _ in range(rng.randint(1, 3)))
    content = f"{head}>{'<g>' * deep}{body}{'</g>' * deep}</svg>"
    return _painting(folder / "drawing.svg", content.encode("utf-8", errors="replace"))


def _element(rng: random.Random) -> str:
    tag = rng.choice(TAGS[1:8] if rng.random() < 0.9 else TAGS)
    # The attributes that the element has of its own, so that most files come as far as its shape.
    own = {
        "path": {"d": "M2 2L18 4L9 16z"},
        "rect": {"x": "2", "y": "3", "width": "9", "height": "7"},
        "circle": {"cx": "9", "cy": "9", "r": "5"},
        "ellipse": {"cx": "9", "cy": "9", "rx": "6", "ry": "3"},
        "line": {"x1": "1", "x2": "15", "y2": "9", "stroke": "red"},
        "polyline": {"points": "1 1 9 9 5 15"},
        "polygon": {"points": "1 1 9 9 5 15"},
    }.get(tag, {})
    for _ in range(rng.choice((0, 1, 1, 1, 2))):
        own[rng.choice(tuple(own) if own and rng.random() < 0.8 else (*GEOMETRY, *STYLE))] = rng.choice(VALUES)
    return f"<{tag}{''.join(f' {key}={quoteattr(value)}' for key, value in own.items())}/>"


def _attributes(rng: random.Random, names: tuple[str, ...]) -> str:
    return "".join(f" {key}={quoteattr(rng.choice(VALUES))}" for key in rng.sample(names, rng.randint(0, 2)))

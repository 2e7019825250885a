"""What notebooks show of objects: small pieces of HTML without a style sheet, readable on dark and on light pages.

Colours are the page's own, or grey that shows on both; every text is escaped.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Collection, Iterable, Sequence
from html import escape
from typing import Final

__all__ = ["card", "paragraph", "picture", "side_by_side", "sparkline", "table"]

LINE: Final = "1px solid rgba(128,128,128,.4)"
WIDTH: Final = 240  # of a sparkline, in CSS pixels
HEIGHT: Final = 56
MARGIN: Final = 4
SIDE: Final = 128  # the longer one of a picture, in CSS pixels


def card(title: str, *parts: str) -> str:
    """One box with a title around pieces of HTML; empty ones are left out."""
    inside = "".join(f'<div style="margin-top:.5em">{part}</div>' for part in parts if part)
    return (
        f'<div style="border:{LINE};border-radius:6px;padding:.6em .9em;display:inline-block;max-width:100%;'
        f'overflow-x:auto;font-size:13px;line-height:1.4"><strong>{escape(title)}</strong>{inside}</div>'
    )


def table(rows: Iterable[Sequence[str]], heads: Sequence[str] = (), *, right: Collection[int] = ()) -> str:
    """A table of texts.

    Parameters
    ----------
    rows : iterable of sequence of str
        The first cell of each names the row.
    heads : sequence of str
        What the columns are; without them none is said.
    right : collection of int
        Columns of numbers, which are aligned to the right.
    """

    def cell(kind: str, column: int, text: str) -> str:
        side = "right" if column in right else "left"
        weight = ";font-weight:600" if kind == "th" else ""
        scope = "" if kind == "td" else ' scope="row"' if column == 0 and not heads else ' scope="col"'
        style = f"text-align:{side};padding:.15em .8em .15em 0;vertical-align:top;border:0{weight}"
        return f'<{kind}{scope} style="{style}">{escape(text)}</{kind}>'

    def line(kinds: Sequence[str], cells: Sequence[str]) -> str:
        each = "".join(cell(kind, column, text) for column, (kind, text) in enumerate(zip(kinds, cells, strict=True)))
        return f'<tr style="background:none">{each}</tr>'

    lines = [line(["th"] * len(heads), heads)] if heads else []
    lines += [line(["td" if heads else "th", *["td"] * (len(row) - 1)], row) for row in rows]
    style = "border-collapse:collapse;margin:0;font-size:inherit;color:inherit;font-variant-numeric:tabular-nums"
    return f'<table style="{style}">{"".join(lines)}</table>'


def paragraph(text: str) -> str:
    """A text, with the lines that it has."""
    return f'<div style="max-width:46em">{escape(text).replace(chr(10), "<br>")}</div>'


def picture(png: bytes, size: tuple[int, int], caption: str) -> str:
    """A picture with a caption.

    Parameters
    ----------
    png : bytes
    size : (int, int)
        Width and height that are in proportion.
    caption : str
    """
    factor = SIDE / max(*size, 1)
    width, height = (max(1, round(factor * side)) for side in size)
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure style="margin:0"><img alt="{escape(caption)}" width="{width}" height="{height}" '
        f'style="image-rendering:pixelated;border:{LINE};margin:0" src="data:image/png;base64,{data}">'
        f'<figcaption style="font-size:12px">{escape(caption)}</figcaption></figure>'
    )


def side_by_side(parts: Iterable[str]) -> str:
    """Pieces of HTML in a row, which wraps; empty ones are left out."""
    inside = "".join(part for part in parts if part)
    return f'<div style="display:flex;flex-wrap:wrap;gap:.8em;align-items:flex-start">{inside}</div>' if inside else ""


def sparkline(lines: Sequence[Sequence[tuple[float, float]]], caption: str) -> str:
    """Curves in one small frame with a caption, each from left to right; nothing if no curve has two points.

    Parameters
    ----------
    lines : sequence of sequence of (float, float)
        Points (x, y) of each curve, y upwards. Points that are not finite are left out.
    caption : str
    """
    finite = [[point for point in line if all(map(math.isfinite, point))] for line in lines]
    points = [point for line in finite for point in line]
    if not any(len(line) > 1 for line in finite):
        return ""
    (left, right), (low, high) = ((min(axis), max(axis)) for axis in zip(*points, strict=True))

    def placed(value: float, least: float, most: float, room: int) -> float:
        return MARGIN + (room - 2 * MARGIN) * ((value - least) / (most - least) if most > least else 0.5)

    drawn = "".join(
        '<polyline points="'
        + " ".join(f"{placed(x, left, right, WIDTH):.1f},{HEIGHT - placed(y, low, high, HEIGHT):.1f}" for x, y in line)
        + '" fill="none" stroke="currentColor" stroke-width="1.5"/>'
        for line in finite
        if len(line) > 1
    )
    return (
        f'<figure style="margin:0"><svg role="img" aria-label="{escape(caption)}" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" style="border:{LINE}">{drawn}</svg>'
        f'<figcaption style="font-size:12px">{escape(caption)}</figcaption></figure>'
    )

"""The HTML that notebooks show of results and objectives: no style sheet, readable on light and dark pages.

Colours are the colours of the page, or a grey that is visible on both. Every text is escaped.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

__all__ = ["card", "figure", "picture", "row", "table"]

BORDER: Final = "1px solid rgba(128,128,128,.4)"
PICTURE_SIDE: Final = 128  # the longer side, in CSS pixels


def card(title: str, *pieces: str) -> str:
    """Return a box with a title around pieces of HTML; empty pieces are left out."""
    content = "".join(f'<div style="margin-top:.5em">{piece}</div>' for piece in pieces if piece)
    return (
        f'<div style="border:{BORDER};border-radius:6px;padding:.6em .9em;display:inline-block;max-width:100%;'
        f'overflow-x:auto;font-size:13px;line-height:1.4"><strong>{escape(title)}</strong>{content}</div>'
    )


def row(pieces: Iterable[str]) -> str:
    """Return pieces of HTML side by side, with line breaks where they do not fit."""
    return f'<div style="display:flex;flex-wrap:wrap;gap:.8em;align-items:flex-start">{"".join(pieces)}</div>'


def table(rows: Iterable[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """Return a table of texts; without heads, the first cell of each row is its head."""

    def cell(tag: str, scope: str, text: str) -> str:
        weight = 600 if scope else 400
        style = f"text-align:left;padding:.15em .8em .15em 0;vertical-align:top;border:0;font-weight:{weight}"
        return f'<{tag}{scope} style="{style}">{escape(text)}</{tag}>'

    def line(cells: Iterable[str]) -> str:
        return f'<tr style="background:none">{"".join(cells)}</tr>'

    lines = [line(cell("th", ' scope="col"', head) for head in heads)] if heads else []
    for first, *remaining in rows:
        tag, scope = ("td", "") if heads else ("th", ' scope="row"')
        lines.append(line([cell(tag, scope, first), *(cell("td", "", text) for text in remaining)]))
    style = "border-collapse:collapse;margin:0;font-size:inherit;color:inherit;font-variant-numeric:tabular-nums"
    return f'<table style="{style}">{"".join(lines)}</table>'


def figure(content: str, caption: str) -> str:
    """Return a piece of HTML with a caption; empty if the piece is."""
    if not content:
        return ""
    caption = f'<figcaption style="font-size:12px">{escape(caption)}</figcaption>'
    return f'<figure style="margin:0"><div style="border:{BORDER};width:fit-content">{content}</div>{caption}</figure>'


def picture(png: bytes, size: tuple[int, int], caption: str) -> str:
    """Return a PNG with a caption, shown with the proportions of `size`, (width, height)."""
    factor = PICTURE_SIDE / max(*size, 1)
    width, height = (max(1, round(factor * length)) for length in size)
    data = base64.b64encode(png).decode("ascii")
    return figure(
        f'<img alt="{escape(caption)}" width="{width}" height="{height}" '
        f'style="image-rendering:pixelated;margin:0" src="data:image/png;base64,{data}">',
        caption,
    )

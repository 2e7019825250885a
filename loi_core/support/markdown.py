"""Tables of text, with columns as wide as their widest cells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["columns", "markdown"]


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table that is also readable in a terminal."""
    table = [list(heads), *map(list, rows)]
    widths = _widths(table)
    lines = ["| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in table]
    return [lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]]


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table without rules: the first column aligned to the left, the others to the right."""
    first, *following = _widths(rows)
    return ["  ".join([row[0].ljust(first), *map(str.rjust, row[1:], following)]) for row in rows]


def _widths(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, cells)) for cells in zip(*rows, strict=True)]

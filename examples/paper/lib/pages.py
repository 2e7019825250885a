"""Tables in pages that people write: each between two marks, so that a command can put a new one there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from loi_core.io.files import write_text

__all__ = ["fill", "filled"]


def fill(page: Path, tables: Mapping[str, Sequence[str]]) -> None:
    """Put the tables into a page that is there; errors as :func:`filled`."""
    write_text(page, filled(page.read_text(encoding="utf-8"), tables))


def filled(page: str, tables: Mapping[str, Sequence[str]]) -> str:
    """`page`, with the lines of each table between ``<!-- NAME -->`` and ``<!-- end -->``.

    Raises
    ------
    ValueError
        If the page has no such place for a table.
    """
    for name, table in tables.items():
        start, end = f"<!-- {name} -->\n", "<!-- end -->"
        before, mark, after = page.partition(start)
        old, closing, rest = after.partition(end)
        if not (mark and closing) or "<!--" in old:
            msg = f"the page must have a place for the table {name!r}, from {start.strip()} to {end}"
            raise ValueError(msg)
        page = before + start + "\n".join(["", *table, "", end]) + rest
    return page

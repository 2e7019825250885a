"""Generated tables in handwritten pages: each table lies between two marks, so that a command can replace it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from loi_core.io.files import write_text

__all__ = ["fill", "filled"]


def fill(page: Path, tables: Mapping[str, Sequence[str]]) -> None:
    """Replace tables in an existing page; raise the errors of :func:`filled`."""
    write_text(page, filled(page.read_text(encoding="utf-8"), tables))


def filled(page: str, tables: Mapping[str, Sequence[str]]) -> str:
    """Return `page` with the lines of each table between ``<!-- NAME -->`` and ``<!-- end -->``.

    Raises
    ------
    ValueError
        If the page lacks the marks of a table.
    """
    for name, table in tables.items():
        opening_mark, closing_mark = f"<!-- {name} -->\n", "<!-- end -->"
        head, opening, tail = page.partition(opening_mark)
        old_table, closing, tail = tail.partition(closing_mark)
        if not (opening and closing) or "<!--" in old_table:
            msg = f"the page must have a place for the table {name!r}, from {opening_mark.strip()} to {closing_mark}"
            raise ValueError(msg)
        page = head + opening_mark + "\n".join(["", *table, "", closing_mark]) + tail
    return page

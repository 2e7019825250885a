"""Tables in pages that people write: each between two marks, so that a command can put a new one there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["filled"]


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

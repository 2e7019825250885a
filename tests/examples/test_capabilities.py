"""The table of what works where is what trying finds."""

from __future__ import annotations

from examples.capabilities import table
from tests.environments import ROOT


def test_the_table_of_the_docs_is_what_trying_finds() -> None:
    assert "\n".join(table()) in (ROOT / "docs" / "backends.md").read_text()

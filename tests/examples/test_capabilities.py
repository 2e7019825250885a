"""The table of what works where is what trying finds."""

from __future__ import annotations

import pytest

from examples.capabilities import table
from tests.environments import ROOT
from tests.strategies import THOROUGH


@pytest.mark.skipif(not THOROUGH, reason="half a minute; in the thorough tier")
def test_the_table_of_the_docs_is_what_trying_finds() -> None:
    assert "\n".join(table()) in (ROOT / "docs" / "results" / "backends.md").read_text()

"""Test of the table of capabilities by backend."""

from __future__ import annotations

import pytest

from examples.capabilities import table
from tests.environments import ROOT
from tests.strategies import THOROUGH


@pytest.mark.skipif(not THOROUGH, reason="half a minute; in the thorough tier")
def test_the_documented_capabilities_equal_measured_capabilities() -> None:
    assert "\n".join(table()) in (ROOT / "docs" / "results" / "backends.md").read_text()

"""The lower bounds of what is required are versions that the tests pass with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.lowest import USUAL, check
from tests.strategies import THOROUGH


@pytest.mark.skipif(not THOROUGH, reason="installs and tests for many minutes")
@pytest.mark.parametrize("extra", USUAL)
def test_tests_pass_at_the_lowest_versions(extra: str, tmp_path: Path) -> None:
    check([extra], tmp_path)

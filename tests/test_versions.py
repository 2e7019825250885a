"""Tests pass at the lowest versions that the project requires."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.strategies import THOROUGH
from tests.versions import DEFAULT_EXTRAS, check


@pytest.mark.skipif(not THOROUGH, reason="installs and tests for many minutes")
@pytest.mark.parametrize("extra", DEFAULT_EXTRAS)
def test_tests_pass_at_the_lowest_versions(extra: str, tmp_path: Path) -> None:
    check("lowest", [extra], tmp_path)

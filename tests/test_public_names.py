"""Public names and arguments change only on purpose."""

from __future__ import annotations

from tests.environments import ROOT
from tests.public_names import lines


def test_public_names_and_their_arguments_equal_the_record() -> None:
    recorded = (ROOT / "tests" / "data" / "public_names.txt").read_text().splitlines()
    assert list(lines()) == recorded, "if this is intended: python -m tests.public_names > tests/data/public_names.txt"

"""Nothing in a file, a command line or a plugin does harm: `claims.py` says what is held, `kinds.py` what is tried."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

from tests.fuzz.claims import Kind, check
from tests.fuzz.kinds import KINDS


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_every_input_ends_in_an_answer_or_one_of_our_errors(kind: Kind, tmp_path: Path) -> None:
    assert settings.default is not None
    count = settings.default.max_examples * kind.weight // 2
    outcomes = {check(kind, seed, tmp_path) for seed in range(count)}
    assert not all(one.endswith("Error") for one in outcomes)  # some inputs are good, or nothing was told apart

"""The paper's first scene, small: a shadow under a point light leads a fit to what throws it."""

from __future__ import annotations

import json

import pytest

from examples.paper.table2 import shadow
from tests.strategies import thorough


@thorough
def test_what_throws_a_shadow_is_found_with_the_scene_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    shadow.main(["--quick", "--json"])
    (line,) = capsys.readouterr().out.strip().splitlines()
    outcome = json.loads(line)
    assert outcome["found"]
    assert outcome["start"] == list(shadow.START)
    assert outcome["mae"] < shadow.MAX_FOUND_ERROR


def test_options_are_checked(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        shadow.main(["--starts", "0"])
    assert "must be 1 or more" in capsys.readouterr().err

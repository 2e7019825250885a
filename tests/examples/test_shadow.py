"""Tests of the paper's first scene at a small size: a fit recovers a sphere from its shadow under a point light."""

from __future__ import annotations

import json

import pytest

from examples.paper.table2 import shadow
from tests.strategies import thorough


@thorough
def test_a_fit_recovers_a_sphere_from_its_shadow_under_a_point_light(capsys: pytest.CaptureFixture[str]) -> None:
    shadow.main(["--quick", "--json"])
    (line,) = capsys.readouterr().out.strip().splitlines()
    outcome = json.loads(line)
    assert outcome["found"]
    assert outcome["start"] == list(shadow.START)
    assert outcome["mae"] < shadow.MAX_FOUND_ERROR


def test_the_shadow_experiment_refuses_a_count_of_0(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        shadow.main(["--starts", "0"])
    assert "must be 1 or more" in capsys.readouterr().err

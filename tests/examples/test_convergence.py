"""Tests of the convergence suite in its quick tier: two warps and a vector scene."""

from __future__ import annotations

import pytest

from examples.convergence.__main__ import row
from examples.convergence.flat import VECTORS, WARPS
from tests.strategies import thorough


@pytest.mark.parametrize(
    "case", [pytest.param(WARPS[1], marks=thorough), WARPS[9], VECTORS[0]], ids=lambda case: str(case.name)
)
def test_untuned_scenes_converge_from_distant_starts_with_default_settings(case: object) -> None:
    _, converged, _, correct, verdicts, _ = row(case, [1])  # type: ignore[arg-type]  # pytest passes objects
    assert converged == "1 of 1", verdicts
    assert correct == "1 of 1", verdicts

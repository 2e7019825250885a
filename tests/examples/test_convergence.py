"""The suite of scenes that nobody tuned, in its quick tier: one of each kind."""

from __future__ import annotations

import pytest

from examples.convergence.__main__ import row
from examples.convergence.flat import VECTORS, WARPS
from tests.strategies import thorough


@pytest.mark.parametrize(
    "case", [pytest.param(WARPS[1], marks=thorough), WARPS[9], VECTORS[0]], ids=lambda case: str(case.name)
)
def test_scenes_are_found_from_far_with_every_default(case: object) -> None:
    _, found, _, right, verdicts, _ = row(case, [1])  # type: ignore[arg-type]  # of pytest
    assert found == "1 of 1", verdicts
    assert right == "1 of 1", verdicts

"""docs/untrusted-input.md names, beside every claim, a test that holds it."""

from __future__ import annotations

import re

from tests.environments import ROOT

PAGE = (ROOT / "docs" / "untrusted-input.md").read_text()
NAMED = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def test_every_claim_has_a_test() -> None:
    claims = [
        line
        for table in re.findall(r"\|[^\n]*held by \|\n\| ---[^\n]*\n((?:\|[^\n]*\n)+)", PAGE)
        for line in table.splitlines()
    ]
    assert len(claims) >= 20
    for claim in claims:
        holds = claim.rsplit("|", 2)[1]
        assert "*fuzz*" in holds or NAMED.search(holds), claim


def test_every_test_that_is_named_is_there() -> None:
    named = NAMED.findall(PAGE)
    assert len(named) >= 30
    for path, name in named:
        assert f"def {name}(" in (ROOT / path).read_text(), f"{path}::{name}"

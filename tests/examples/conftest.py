"""Load the frameworks for the tests of this folder."""

from __future__ import annotations

from tests.frameworks import load

for framework in ("jax", "torch"):
    load(framework)

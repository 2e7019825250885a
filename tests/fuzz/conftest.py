"""Settings for the tests of this folder, which use the frameworks."""

from __future__ import annotations

from tests.frameworks import load

for framework in ("jax", "torch"):
    load(framework)

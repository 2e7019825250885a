"""Settings for the tests of this folder, which use the frameworks."""

from __future__ import annotations

from tests.frameworks import load_installed

load_installed("jax", "torch")

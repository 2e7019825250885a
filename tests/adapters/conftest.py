"""Load the frameworks for the tests of this folder."""

from __future__ import annotations

from tests.frameworks import load_installed

load_installed("jax", "torch")

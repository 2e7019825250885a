"""Settings for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import jax
import matplotlib as mpl
import pytest
import torch
from hypothesis import HealthCheck, settings

from tests.environments import build_wheel

jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # untyped in JAX
mpl.use("agg")
torch.set_num_threads(1)  # the tests run in several processes already

for name, examples in (("quick", 10), ("ci", 40), ("thorough", 1000)):
    settings.register_profile(
        name,
        max_examples=examples,
        deadline=None,
        derandomize=name == "ci",
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The distribution as a user gets it."""
    return build_wheel(tmp_path_factory.mktemp("dist"))

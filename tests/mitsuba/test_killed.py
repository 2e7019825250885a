"""A fit of a Mitsuba scene that was killed, and resumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.mitsuba.test_scene_file import folder
from tests.survival.processes import ends

__all__ = ["folder"]


def test_a_fit_of_a_mitsuba_scene_that_was_killed_comes_within_a_quarter_of_a_pixel(folder: Path) -> None:
    broken, whole = ends(folder / "scene.toml", "place")
    # A pixel is 0.24 units of the world there. Mitsuba adds gradients up in the order in which its threads come, and
    # with 8 samples a pixel roundings grow: two fits that nothing has cut short end 0.02 apart.
    np.testing.assert_allclose(broken, whole, atol=0.06)

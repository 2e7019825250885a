"""The guide's scene is found as the guide says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np


def test_the_scene_of_the_guide_is_found() -> None:
    guide = (Path(__file__).parents[2] / "docs" / "mitsuba.md").read_text()
    code = guide.split("```python\n")[1].split("```")[0]
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    found = np.array(done.stdout.replace("[", " ").replace("]", " ").split()[-3:], dtype=float)
    np.testing.assert_allclose(found, [1.5, -1.0, 0.0], atol=0.05)

"""Gradients in a process with the threads that users have; the other tests run with one."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np

from tests.environments import ROOT

PULLBACK = """
import loi_mitsuba  # before Dr.Jit
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
from tests.mitsuba.scenes import random_cotangent, shadow_scene

lamp = {"type": "point", "position": [0.5, 9.0, 0.0], "intensity": 100.0}
for count in (2, 1):
    dr.set_thread_count(count)
    planned = loi_mitsuba.PlannedRenderer(shadow_scene(lamp=lamp), {"place": "lamp.position"}, spp=4)
    gradient = planned.render_vjp(planned.parameters(), seed=1)[1](random_cotangent())["place"]
    print(*gradient)
"""


def test_a_moving_point_light_has_the_same_gradient_on_two_threads_as_on_one() -> None:
    paths = os.pathsep.join([str(ROOT), str(ROOT / "adapters")])
    variables = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    run = subprocess.run(
        [sys.executable, "-c", PULLBACK],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**variables, "PYTHONPATH": paths},
    )
    assert run.returncode == 0, run.stderr
    two, one = (np.array(line.split(), dtype=np.float64) for line in run.stdout.splitlines())
    assert np.all(one != 0.0)
    np.testing.assert_allclose(two, one, rtol=1e-3)  # sums of float32 terms in another order

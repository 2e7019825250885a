"""``python -m examples.paper orb``: the position of a glass orb on a table, from a simulated photograph.

The paper has a real photograph. This one is rendered with wavelengths, in a configuration that differs from the model,
through a lens and a sensor, with camera and light off by 1 %. All methods have gradients by blurring over the
parameters (Fischer and Ritschel, CVPR 2023), each at the best of a small search.
"""

from __future__ import annotations

from functools import partial

from examples.paper.variational.command import run_scene

__all__ = ["main"]

main = partial(run_scene, "orb", __doc__)

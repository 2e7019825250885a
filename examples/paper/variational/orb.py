"""``python -m examples.paper orb``: the position of a glass orb on a table, from a simulated photograph.

The paper uses a real photograph. This one is rendered spectrally, with camera and light that differ from the model by
1 %, and passes a simulated lens and sensor. All methods differentiate a blur over the parameters (Fischer and Ritschel,
CVPR 2023), each with the best settings of a small search.
"""

from __future__ import annotations

from functools import partial

from examples.paper.variational.command import run_scene

__all__ = ["main"]

main = partial(run_scene, "orb", __doc__)

"""Find a brick in Blender, which has no gradients: ``python -m examples.loops.with_bpy``.

It needs Blender as a module, ``pip install --no-deps bpy``, and runs on a processor.
"""

from typing import Any

import bpy
import numpy as np
from PIL import Image

from examples.loops.scenes import brick
from loi_core import Free, LOIObjective, Objective, PixelL2, fit
from loi_core.renderers import BlurredRenderer

scene, block = brick.build()


class Blender:
    """The brick at a place, in Blender's units, and turned, in radians about the view."""

    def parameters(self) -> dict[str, Any]:
        """Return the start."""
        return {"place": np.array([-2.2, 1.4]), "turn": np.array(0.0)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        """Return the image, shape (48, 64, 3)."""
        block.location[:2], block.rotation_euler[2] = params["place"], params["turn"]
        scene.cycles.seed = seed
        bpy.ops.render.render(write_still=True)
        return np.asarray(Image.open(scene.render.filepath)) / 255.0

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> tuple[Any, Any]:
        """Raise an error: Blender has no gradient."""
        raise NotImplementedError


truth = {"place": np.array([2.0, -1.2]), "turn": np.array(0.8)}
photograph = Blender().render(truth)
free = {"place": Free(lower=-3.0, upper=3.0), "turn": Free(lower=-1.5, upper=1.5)}


def error(objective: Objective) -> float:
    """Return the error of the place after 100 steps, each along the differences of two pairs of renders."""
    blurred = BlurredRenderer(Blender(), "2 px", pairs=2)
    result = fit(blurred, objective, steps=100, optimise=free)
    return float(np.linalg.norm(result.best_params["place"] - truth["place"]))


errors = error(PixelL2(photograph)), error(LOIObjective(photograph))  # Blender prints lines as it renders
print("L2 ", round(errors[0], 2))
print("loi", round(errors[1], 2))

"""
Mitsuba: where is it, by its shadow alone?
==========================================

A ball hangs out of view, under a point light. Mitsuba itself has no gradient of such a shadow, as hardly any ray hits
the light. ``PlannedRenderer`` sees that, and takes the gradient from a neighbouring scene; the image stays as it is.
"""

import loi_mitsuba  # before mitsuba: it finds an LLVM that works

# isort: split
import mitsuba as mi
import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from pictures import Film

mi.set_variant("llvm_ad_rgb")
height, width = 36, 48
transform = mi.ScalarTransform4f
scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 2},  # direct light only
    "camera": {
        "type": "perspective",
        "fov": 45,
        "to_world": transform().look_at([0, 6, 6], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "sample_border": True},
    },
    "lamp": {"type": "point", "position": [0, 12, 0], "intensity": 150.0},
    "sky": {"type": "constant", "radiance": 0.1},
    "floor": {
        "type": "rectangle",
        "to_world": transform().rotate([1, 0, 0], -90).scale(8),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.5, 0.35]}},
    },
    "ball": {"type": "sphere", "to_world": transform().translate([0, 5, 0]).scale(0.7)},
}
moves = {"x": loi_mitsuba.Translate("ball", [1, 0, 0]), "z": loi_mitsuba.Translate("ball", [0, 0, 1])}
truth, start = {"x": 0.9, "z": -0.6}, {"x": -1.1, "z": 0.5}
renderer = loi_mitsuba.PlannedRenderer(scene, moves, spp=32)
photograph = renderer.unabridged.render({name: np.float32(value) for name, value in truth.items()}, seed=1000)

# %%
# The plan lists the simulated effects and the reason for each.

objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
free = {name: Free(value, -2.0, 2.0) for name, value in start.items()}
film = Film(photograph, linear=True)
result = fit(renderer, objective, steps=50, learning_rate=0.1, optimise=free, callback=film)
print(result.plan)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
solution = {name: float(value) for name, value in result.best_params.items()}
start_error, final_error = (
    float(np.hypot(params["x"] - truth["x"], params["z"] - truth["z"])) for params in (start, solution)
)
print(f"off by {start_error:.2f} units at the start, {final_error:.3f} at the end; a pixel of the shadow is about 0.08")
assert final_error < 0.08

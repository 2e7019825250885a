"""
Mitsuba: a ball on a floor
==========================

``MitsubaRenderer`` turns a Mitsuba scene into named parameters and an image. Name the free parameters, give bounds, and
``fit`` estimates them: here a ball, by its outline, its shading and its shadow.
"""

import loi_mitsuba  # before mitsuba, to choose an LLVM

# isort: split
import mitsuba as mi
import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from pictures import Film

mi.set_variant("llvm_ad_rgb")
height, width = 48, 64
transform = mi.ScalarTransform4f
scene = {
    "type": "scene",
    "camera": {
        "type": "perspective",
        "fov": 45,
        "to_world": transform().look_at([0, 5, 6], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "sample_border": True},
    },
    "lamp": {
        "type": "sphere",
        "to_world": transform().translate([2, 7, 1]).scale(0.8),
        "emitter": {"type": "area", "radiance": 22.0},
    },
    "sky": {"type": "constant", "radiance": 0.15},
    "floor": {
        "type": "rectangle",
        "to_world": transform().rotate([1, 0, 0], -90).scale(8),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.45, 0.5, 0.4]}},
    },
    "ball": {
        "type": "sphere",
        "to_world": transform().translate([0, 0.6, 0]).scale(0.6),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.85, 0.25, 0.1]}},
    },
}

# %%
# The ball rolls on the floor, so it moves along two axes. The photograph has more samples and less noise.

moves = {"x": loi_mitsuba.Translate("ball", [1, 0, 0]), "z": loi_mitsuba.Translate("ball", [0, 0, 1])}
truth, start = {"x": 1.8, "z": 0.9}, {"x": -1.8, "z": -0.9}
photographer = loi_mitsuba.MitsubaRenderer(scene, moves, spp=256)
photograph = photographer.render({name: np.float32(value) for name, value in truth.items()}, seed=1000)

# %%
renderer = loi_mitsuba.MitsubaRenderer(scene, moves, spp=8)
objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
free = {name: Free(value, -2.5, 2.5) for name, value in start.items()}
film = Film(photograph, linear=True)
result = fit(renderer, objective, steps=80, learning_rate="1.5 px", optimise=free, callback=film)
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
print(f"off by {start_error:.2f} units at the start, {final_error:.3f} at the end; a pixel is about 0.13")
assert final_error < 0.13

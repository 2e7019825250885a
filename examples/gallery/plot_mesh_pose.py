"""
Torch: the pose of a mesh
=========================

With torch alone, ``loi_torch.mesh`` draws meshes with gradients by whatever moves them. Here a painted box is moved and
turned at once: three numbers for its place, and an angle about its upright axis.
"""

from typing import Any

import numpy as np
import torch

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_torch.mesh import Camera, Light, MeshRenderer, Rotate, Translate, box
from pictures import Film

height, width = 60, 90
paint = [[0.9, 0.2, 0.1], [0.1, 0.6, 0.9], [0.9, 0.7, 0.1], [0.2, 0.7, 0.3], [0.6, 0.3, 0.8], [0.9, 0.9, 0.9]]
crate = box((1.8, 1.1, 0.8), colours=np.repeat(paint, 2, axis=0))  # two triangles a side
renderer = MeshRenderer(
    height,
    width,
    {"crate": crate},
    Camera((0.0, 2.0, 8.0), fov=40.0),
    {"place": Translate("crate"), "turn": Rotate("crate", axis=(0, 1, 0))},
    lights={"sun": Light(direction=(-1.0, -2.0, -3.0)), "sky": Light(colour=0.4)},
)
truth: dict[str, Any] = {"place": [2.1, -0.9, 0.4], "turn": -35.0}
start: dict[str, Any] = {"place": [-2.2, 1.0, -0.5], "turn": 25.0}
photograph = renderer.render({name: torch.tensor(value, dtype=torch.float64) for name, value in truth.items()})

# %%
objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
free = {"place": Free(start["place"], -3.0, 3.0), "turn": Free(start["turn"], -90.0, 90.0)}
film = Film(photograph, linear=True)
result = fit(renderer, objective, steps=150, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
found = {name: value.tolist() for name, value in result.best_params.items()}
before, after = (float(np.linalg.norm(np.subtract(one["place"], truth["place"]))) for one in (start, found))
print(f"off by {before:.2f} units at the start, {after:.4f} at the end; a pixel is 0.1")
print(f"turned by {found['turn']:.2f} degrees, and in truth by {truth['turn']}")
assert after < 0.1
assert abs(found["turn"] - truth["turn"]) < 2.0

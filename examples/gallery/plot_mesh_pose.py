"""
Torch: the pose of a mesh
=========================

With torch alone, ``loi_torch.mesh`` draws meshes with gradients with respect to their poses. Here a painted box moves
and rotates at once: three numbers for its position, and an angle about its vertical axis.
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
# From one start the fit would end at a bound, where its verdict advises ``starts=8``: eight points within the bounds.

objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
free = {"place": Free(start["place"], -3.0, 3.0), "turn": Free(start["turn"], -90.0, 90.0)}
film = Film(photograph, linear=True)
film.keep(renderer.render({name: torch.tensor(value, dtype=torch.float64) for name, value in start.items()}))
result = fit(renderer, objective, steps=150, optimise=free, starts=8, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
solution = {name: value.tolist() for name, value in result.best_params.items()}
start_error, final_error = (
    float(np.linalg.norm(np.subtract(params["place"], truth["place"]))) for params in (start, solution)
)
print(f"off by {start_error:.2f} units at the start, {final_error:.4f} at the end; a pixel is 0.1")
print(f"turned by {solution['turn']:.2f} degrees, and in truth by {truth['turn']}")
assert final_error < 0.1
assert abs(solution["turn"] - truth["turn"]) < 2.0

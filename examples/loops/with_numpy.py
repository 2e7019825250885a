"""The loop of the README on NumPy, as a whole program: ``python -m examples.loops.with_numpy``."""

import numpy as np

from loi_core import LOIObjective, ScaleSpace
from loi_core.renderers import Disks

height, width = 64, 96
renderer = Disks(height, width, positions=[[75.0, 45.0]], radii=8.0, colours=[[1.0, 0.6, 0.1]])
photograph = renderer.render(renderer.parameters())
params = {**renderer.parameters(), "positions": np.array([[15.0, 15.0]])}

objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
for step in range(200):
    image, pullback = renderer.render_vjp(params)
    value, gradient = objective.value_and_grad(image)
    slope = pullback(gradient)["positions"]
    rate = 1.0 - step / 200  # pixels a step, along the gradient: its length says little far from the target
    params["positions"] = params["positions"] - rate * slope / max(float(np.linalg.norm(slope)), 1e-12)

print(*params["positions"][0].round(1))

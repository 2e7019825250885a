"""
Weights: a photograph with an occluder
======================================

A passer-by, whom the renderer cannot draw, stands in the photograph. ``weights`` are the weights of the pixels, in
every loss of ``loi_core``; here the pixels of the passer-by have weight 0.
"""

import numpy as np

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Disks
from pictures import Film

height, width = 64, 96
renderer = Disks(
    height, width, positions=[[16.0, 14.0]], radii=8.0, colours=[[0.95, 0.8, 0.1]], background=[0.2, 0.35, 0.5]
)
truth = np.array([[78.0, 44.0]])
photograph = renderer.render({**renderer.parameters(), "positions": truth})
y, x = np.mgrid[:height, :width]
person = (np.abs(x - 40) < 7) & (y > 16)
photograph[person] = [0.9, 0.7, 0.2]

# %%
# Without weights, the ball moves to the passer-by, whose colour is similar.

free = {"positions": Free(lower=0.0, upper=[[width, height]])}
unaware = fit(renderer, LOIObjective(photograph), steps=100, optimise=free)
print(unaware.diagnosis)

# %%
# The mask need not be exact: it may cover a little more than the occluder.

weights = 1.0 - ((np.abs(x - 40) < 9) & (y > 14))
film = Film(photograph)
result = fit(renderer, LOIObjective(photograph, weights=weights), steps=100, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
start = renderer.parameters()
start_error, unmasked_error, final_error = (
    float(np.linalg.norm(params["positions"] - truth)) for params in (start, unaware.best_params, result.best_params)
)
print(
    f"error: {start_error:.1f} px at the start, {unmasked_error:.1f} px without weights, {final_error:.3f} px with them"
)
assert final_error < 0.2

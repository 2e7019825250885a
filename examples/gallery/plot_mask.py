"""
Weights: a photograph with something in the way
===============================================

A passer-by stands in the photograph, and the renderer cannot make one. ``weights`` say how much each pixel counts, in
every loss of ``loi_core``; here those of the passer-by count nothing.
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
# Without weights, the ball is drawn to the passer-by, who is nearly of its colour.

free = {"positions": Free(lower=0.0, upper=[[width, height]])}
unaware = fit(renderer, LOIObjective(photograph), steps=100, optimise=free)
print(unaware.diagnosis)

# %%
# The mask need not be exact: leave out a little more than is in the way.

counts = 1.0 - ((np.abs(x - 40) < 9) & (y > 14))
film = Film(photograph)
result = fit(renderer, LOIObjective(photograph, weights=counts), steps=100, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
start = renderer.parameters()
before, without, after = (
    float(np.linalg.norm(one["positions"] - truth)) for one in (start, unaware.best_params, result.best_params)
)
print(f"off by {before:.1f} px at the start, {without:.1f} px at the end without weights, {after:.3f} px with them")
assert after < 0.2

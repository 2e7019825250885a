"""
Where the defaults stall: a periodic pattern
============================================

A checkered tile lies on a checkered floor. The loss has a local minimum wherever the squares match. A fit without
bounds ends in the nearest minimum, and its verdict reports it.
"""

import numpy as np

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Warp
from pictures import Film

height, width = 72, 108
y, x = np.mgrid[:height, :width]
floor = np.where((x // 9 + y // 9) % 2 == 0, 0.3, 0.6)[..., None] * [1.0, 0.95, 0.85]
tile = np.where((x // 9 + y // 9) % 2 == 0, 0.25, 0.65)[:27, :27, None] * [1.0, 0.8, 0.7]
renderer = Warp(tile, floor)
truth = np.array([31.0, 14.0])
photograph = renderer.render({**renderer.parameters(), "translation": truth})
start = np.array([-34.0, -17.0])

# %%
alone = fit(renderer, LOIObjective(photograph), steps=100, optimise={"translation": Free(start)})
print(alone.diagnosis)

# %%
# Give bounds of the tile. A fit that stalls with most of its loss left then searches a better start within these bounds
# and continues from it: in the film, the tile jumps. ``starts=8``, as the verdict suggests, would begin at eight
# points at once; it helps where the search fails.

film = Film(photograph)
free = {"translation": Free(start, [-40.0, -22.0], [40.0, 22.0])}
result = fit(renderer, LOIObjective(photograph), steps=100, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show(without_bounds=alone.image)

# %%
film.play()

# %%
start_error, stuck, final_error = (
    float(np.linalg.norm(params - truth))
    for params in (start, alone.best_params["translation"], result.best_params["translation"])
)
print(f"error: {start_error:.1f} px at the start, {stuck:.1f} px without bounds, {final_error:.3f} px with them")
assert alone.diagnosis is not None
assert not alone.diagnosis.ok
assert final_error < 0.5

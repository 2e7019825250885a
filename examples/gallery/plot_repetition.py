"""
Where the defaults stall: a pattern that repeats
================================================

A checkered tile lies on a checkered floor. Wherever its squares fit those below, the loss has a hollow. A fit without
bounds falls into the next one, and its verdict says so.
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
# Say where the tile can be. A fit that stalls with most of its loss left then looks for a better start within these
# bounds, and goes on from there: in the film, the tile jumps. ``starts=8``, as the verdict says, would begin at eight
# places at once; it helps where that search does not.

film = Film(photograph)
free = {"translation": Free(start, [-40.0, -22.0], [40.0, 22.0])}
result = fit(renderer, LOIObjective(photograph), steps=100, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show(without_bounds=alone.image)

# %%
film.play()

# %%
before, stuck, after = (
    float(np.linalg.norm(one - truth))
    for one in (start, alone.best_params["translation"], result.best_params["translation"])
)
print(f"off by {before:.1f} px at the start, {stuck:.1f} px at the end without bounds, {after:.3f} px with them")
assert alone.diagnosis is not None
assert not alone.diagnosis.ok
assert after < 0.5

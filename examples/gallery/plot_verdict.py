"""
Bounds, many starts, and the verdict
====================================

A fit ends with a verdict: whether it converged and, if not, a remedy. Here a picture starts a third of a turn away
from its target. Without bounds there is no region to search, and the fit stalls.
"""

from typing import Any

import numpy as np
from matplotlib import cbook
from PIL import Image

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Warp
from pictures import Film

height, width = 64, 96
with Image.open(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)) as stored:  # public domain
    portrait = np.asarray(stored.convert("RGB").resize((24, 28), Image.Resampling.LANCZOS)) / 255.0
renderer = Warp(portrait, np.full((height, width, 3), 0.4))
truth: dict[str, Any] = {"translation": np.array([28.0, -10.0]), "rotation": np.array(120.0)}
photograph = renderer.render(renderer.parameters() | truth)
objective = LOIObjective(photograph)
start: dict[str, Any] = {"translation": [-28.0, 12.0], "rotation": 0.0}

# %%
# The picture gets stuck, and the verdict reports it.

alone = fit(renderer, objective, steps=100, optimise={name: Free(value) for name, value in start.items()})
print(alone.diagnosis)

# %%
# With bounds the fit succeeds from this start. ``starts=8`` begins at eight points within them and drops the worse half
# repeatedly. ``agreeing`` counts the remaining starts that ended at the same parameters. The film shows the start,
# then the steps of the winner.

free = {
    "translation": Free(start["translation"], [-40.0, -24.0], [40.0, 24.0]),
    "rotation": Free(start["rotation"], -180.0, 180.0),
}
film = Film(photograph)
film.keep(renderer.render(renderer.parameters() | {name: np.asarray(value) for name, value in start.items()}))
result = fit(renderer, objective, steps=100, optimise=free, starts=8, callback=film)
print(result.diagnosis)
print("agreeing:", result.agreeing)

# %%
film.show(without_bounds=alone.image)

# %%
film.play()

# %%
start_error, stuck, final_error = (
    float(np.linalg.norm(np.subtract(params["translation"], truth["translation"])))
    for params in (start, alone.best_params, result.best_params)
)
print(
    f"error: {start_error:.1f} px at the start, {stuck:.1f} px without bounds, {final_error:.3f} px with eight starts"
)
assert alone.diagnosis is not None
assert not alone.diagnosis.ok
assert final_error < 0.3

"""
Bounds, many starts, and the verdict
====================================

A fit ends with a verdict: whether the target was found and, if not, what to try. Here a picture lies elsewhere, nearly
half a turn from where it belongs. Without bounds there is nowhere to search, and the fit stalls.
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
truth: dict[str, Any] = {"translation": np.array([28.0, -10.0]), "rotation": np.array(170.0)}
photograph = renderer.render(renderer.parameters() | truth)
objective = LOIObjective(photograph)
start: dict[str, Any] = {"translation": [-28.0, 12.0], "rotation": 0.0}

# %%
# The picture gets stuck, and the verdict says so.

alone = fit(renderer, objective, steps=100, optimise={name: Free(one) for name, one in start.items()})
print(alone.diagnosis)

# %%
# With bounds it is found from this start already. ``starts=8`` begins at eight places within them, which race: the
# worse half drops out again and again. ``agreeing`` says how many of those that were left ended in the same place.
# The film has the start, and then what the winner of the race did.

free = {
    "translation": Free(start["translation"], [-40.0, -24.0], [40.0, 24.0]),
    "rotation": Free(start["rotation"], -180.0, 180.0),
}
film = Film(photograph)
film.keep(renderer.render(renderer.parameters() | {name: np.asarray(one) for name, one in start.items()}))
result = fit(renderer, objective, steps=100, optimise=free, starts=8, callback=film)
print(result.diagnosis)
print("agreeing:", result.agreeing)

# %%
film.show(without_bounds=alone.image)

# %%
film.play()

# %%
before, stuck, after = (
    float(np.linalg.norm(np.subtract(one["translation"], truth["translation"])))
    for one in (start, alone.best_params, result.best_params)
)
print(
    f"off by {before:.1f} px at the start, {stuck:.1f} px without bounds, {after:.3f} px with eight starts within them"
)
assert alone.diagnosis is not None
assert not alone.diagnosis.ok
assert after < 0.3

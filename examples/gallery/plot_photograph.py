"""
NumPy: a portrait in a darker, noisy photograph
===============================================

A portrait hangs on a wall, shifted, rotated and scaled. The photograph is darker than the portrait, and noisy.
``Warp`` draws a picture over a background, with gradients with respect to translation, rotation, scale and exposure.
"""

from typing import Any

import numpy as np
from matplotlib import cbook
from PIL import Image

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Warp
from pictures import Film

height, width = 72, 108
with Image.open(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)) as stored:  # public domain
    portrait = np.asarray(stored.convert("RGB").resize((30, 36), Image.Resampling.LANCZOS)) / 255.0
down, x_axis = np.mgrid[:height, :width] / [[[height]], [[width]]]
wall = np.stack([0.33 + 0.15 * x_axis, 0.36 - 0.12 * down, 0.27 + 0.06 * (x_axis + down)], axis=-1)

renderer = Warp(portrait, wall)
truth: dict[str, Any] = {"translation": [30.0, -12.0], "rotation": -24.0, "scale": 0.9, "exposure": -0.4}
noise = np.random.default_rng(7).normal(0.0, 0.04, wall.shape)
photograph = renderer.render({name: np.asarray(value) for name, value in truth.items()}) + noise

# %%
free = {
    "translation": Free([-30.0, 14.0], [-45.0, -30.0], [45.0, 30.0]),
    "rotation": Free(0.0, -90.0, 90.0),
    "scale": Free(1.2, 0.5, 2.0),
    "exposure": Free(0.0, -2.0, 2.0),
}
film = Film(photograph)
result = fit(renderer, LOIObjective(photograph), steps=150, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
start_error = float(np.linalg.norm(np.subtract(free["translation"].initial, truth["translation"])))
final_error = float(np.linalg.norm(result.best_params["translation"] - truth["translation"]))
print(f"off by {start_error:.1f} px at the start, {final_error:.3f} px at the end")
for name in ("rotation", "scale", "exposure"):
    print(f"{name}: {float(result.best_params[name]):.3f}, and in truth {truth[name]}")
assert final_error < 0.3

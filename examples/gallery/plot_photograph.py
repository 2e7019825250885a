"""
NumPy: a photograph in a darker, noisy one
==========================================

A portrait lies somewhere on a wall: moved, turned, smaller. The photograph of it is darker than the picture, and noisy.
``Warp`` puts a picture on a background, and has gradients by place, turn, scale and exposure.
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
down, across = np.mgrid[:height, :width] / [[[height]], [[width]]]
wall = np.stack([0.33 + 0.15 * across, 0.36 - 0.12 * down, 0.27 + 0.06 * (across + down)], axis=-1)

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
before = float(np.linalg.norm(np.subtract(free["translation"].initial, truth["translation"])))
after = float(np.linalg.norm(result.best_params["translation"] - truth["translation"]))
print(f"off by {before:.1f} px at the start, {after:.3f} px at the end")
for name in ("rotation", "scale", "exposure"):
    print(f"{name}: {float(result.best_params[name]):.3f}, and in truth {truth[name]}")
assert after < 0.3

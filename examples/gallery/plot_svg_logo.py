"""
Vector graphics: an SVG logo
============================

``Vector`` paints SVG with gradients with respect to all its numbers, and ``write_svg`` writes the result. Here a fit
moves the shapes of a logo to their places in a picture.
"""

import tempfile
from pathlib import Path

import numpy as np

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_torch.vector import Vector, write_svg
from pictures import Film

size = 64
LOGO = """
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64" style="background-color: #040408">
  <circle cx="44" cy="19" r="8" fill="none" stroke="#f01808" stroke-width="5"/>
  <path d="M9 43 C11 27 23 19 33 21 C35 35 27 45 9 43 Z" fill="#08b820"/>
  <rect x="32" y="40" width="21" height="11" rx="3" transform="rotate(-24 43 46)" fill="#0820f0"/>
</svg>
"""
folder = Path(tempfile.mkdtemp())
(folder / "logo.svg").write_text(LOGO)
renderer = Vector(size, size, svg=folder / "logo.svg", encoding="sRGB")
truth = renderer.parameters()
picture = renderer.render(truth)

# %%
# Positions and rotations are free; colours, sizes and outlines are fixed.

free = {
    "positions": Free([[16.0, 48.0], [50.0, 44.0], [16.0, 18.0]], 0.0, float(size), learning_rate=1.5),
    "rotations": Free([0.0, 25.0, -49.0], learning_rate=2.5),
}
film = Film(picture)
result = fit(renderer, LOIObjective(picture, ScaleSpace.for_image(size, size)), steps=150, optimise=free, callback=film)
print(result.diagnosis)
write_svg(folder / "result.svg", renderer.shapes(result.best_params), size, size)

# %%
film.show()

# %%
film.play()

# %%
target_positions = truth["positions"].numpy()
start_error = float(np.linalg.norm(np.asarray(free["positions"].initial) - target_positions, axis=1).max())
final_error = float(np.linalg.norm(result.best_params["positions"].numpy() - target_positions, axis=1).max())
print(f"the worst shape is off by {start_error:.1f} px at the start, {final_error:.3f} px at the end")
assert final_error < 0.3

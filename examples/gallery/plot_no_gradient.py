"""
A renderer without gradients
============================

Pillow draws without derivatives. ``BlurredRenderer`` computes a gradient from images alone: it draws pairs of
parameters around the current ones and compares their images.
"""

from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import BlurredRenderer
from pictures import Film

height, width = 64, 96


class Pillow:
    """A flag drawn by Pillow with jagged edges: its position in pixels and its lean in degrees."""

    def parameters(self) -> dict[str, Any]:
        """Return the start."""
        return {"place": np.array([20.0, 46.0]), "lean": np.array(25.0)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        """Return the image, (height, width, 3)."""
        image = Image.new("RGB", (width, height), (60, 70, 90))
        draw = ImageDraw.Draw(image)
        angle = np.radians(params["lean"])
        x_axis, down = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        for left, colour in ((-12, (230, 180, 40)), (-4, (235, 235, 235)), (4, (200, 40, 40))):
            corners = [params["place"] + x * x_axis + y * down for x, y in ((left, -7), (left + 8, -7))]
            corners += [params["place"] + x * x_axis + y * down for x, y in ((left + 8, 7), (left, 7))]
            draw.polygon([tuple(corner) for corner in corners], fill=colour)
        return np.asarray(image) / 255.0

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> tuple[Any, Any]:
        """Raise an error: Pillow has no gradient."""
        raise NotImplementedError


# %%
# The blur moves the image by about two pixels, and narrows towards the end.

pillow = Pillow()
truth = {"place": np.array([74.0, 18.0]), "lean": np.array(-20.0)}
photograph = pillow.render(truth)
renderer = BlurredRenderer(pillow, "2 px", pairs=4)
free = {"place": Free(lower=0.0, upper=[width, height]), "lean": Free(lower=-60.0, upper=60.0)}
film = Film(photograph)
objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
result = fit(renderer, objective, steps=200, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
start_error, final_error = (
    float(np.linalg.norm(params["place"] - truth["place"])) for params in (pillow.parameters(), result.best_params)
)
print(f"off by {start_error:.1f} px at the start, {final_error:.2f} px at the end")
print(f"it leans by {float(result.best_params['lean']):.1f} degrees, and in truth by {float(truth['lean'])}")
assert final_error < 0.5

"""
A renderer without gradients
============================

Pillow draws; it knows nothing of derivatives. ``BlurredRenderer`` makes a gradient of images alone: it draws pairs of
parameters about where the fit stands, and compares their images.
"""

from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_core.renderers import BlurredRenderer
from pictures import Film

height, width = 64, 96


class Pillow:
    """A flag, drawn by Pillow with jagged edges: where it is, and how much it leans, in degrees."""

    def parameters(self) -> dict[str, Any]:
        """Where it starts."""
        return {"place": np.array([20.0, 46.0]), "lean": np.array(25.0)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        """The image, (height, width, 3)."""
        image = Image.new("RGB", (width, height), (60, 70, 90))
        draw = ImageDraw.Draw(image)
        angle = np.radians(params["lean"])
        across, down = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        for left, colour in ((-12, (230, 180, 40)), (-4, (235, 235, 235)), (4, (200, 40, 40))):
            corners = [params["place"] + x * across + y * down for x, y in ((left, -7), (left + 8, -7))]
            corners += [params["place"] + x * across + y * down for x, y in ((left + 8, 7), (left, 7))]
            draw.polygon([tuple(one) for one in corners], fill=colour)
        return np.asarray(image) / 255.0

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> tuple[Any, Any]:
        """There is none."""
        raise NotImplementedError


# %%
# The blur is as wide as moves the image by two pixels, and narrows towards the end.

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
before, after = (
    float(np.linalg.norm(one["place"] - truth["place"])) for one in (pillow.parameters(), result.best_params)
)
print(f"off by {before:.1f} px at the start, {after:.2f} px at the end")
print(f"it leans by {float(result.best_params['lean']):.1f} degrees, and in truth by {float(truth['lean'])}")
assert after < 0.5

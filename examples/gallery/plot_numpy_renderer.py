"""
NumPy: a renderer of your own
=============================

A renderer has three methods: its parameters, its image, and a pullback from the gradient of a loss with respect to the
image to the gradient with respect to the parameters. This one draws a moon in the evening sky, with derivatives in
closed form.
"""

from typing import Any

import numpy as np

from loi_core import Free, LOIObjective, fit
from pictures import Film

height, width = 72, 108
y, x = np.mgrid[:height, :width] + 0.5
sky = np.stack([0.1 + 0.5 * y / height, 0.1 + 0.25 * y / height, 0.35 - 0.1 * y / height], axis=-1)
pale = np.array([1.0, 0.95, 0.8])

# %%
# The edge of the moon is a logistic curve one pixel wide, whose derivative is short.


class Moon:
    """A disk with a soft edge: its position and its radius in pixels."""

    def parameters(self) -> dict[str, Any]:
        """Return the start."""
        return {"place": np.array([18.0, 54.0]), "radius": np.array(5.0)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        """Return the image, (height, width, 3)."""
        return self.render_vjp(params)[0]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> tuple[Any, Any]:
        """Return the image and its pullback."""
        dx, dy = x - params["place"][0], y - params["place"][1]
        distance = np.hypot(dx, dy) + 1e-9
        cover = 1.0 / (1.0 + np.exp(np.clip(4.0 * (distance - params["radius"]), -50.0, 50.0)))

        def pullback(cotangent: Any) -> dict[str, Any]:
            outwards = 4.0 * cover * (1.0 - cover) * np.sum(cotangent * (pale - sky), axis=-1)
            position = [np.sum(outwards * dx / distance), np.sum(outwards * dy / distance)]
            return {"place": np.array(position), "radius": np.sum(outwards)}

        return sky + cover[..., None] * (pale - sky), pullback


# %%
# ``fit`` needs only bounds. It measures the unit of each parameter, goes from far to near, and ends with a verdict.

renderer = Moon()
truth = {"place": np.array([84.0, 17.0]), "radius": np.array(9.0)}
photograph = renderer.render(truth)
film = Film(photograph)
free = {"place": Free(lower=0.0, upper=[width, height]), "radius": Free(lower=3.0, upper=15.0)}
result = fit(renderer, LOIObjective(photograph), steps=120, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
start = renderer.parameters()
start_error, final_error = (
    float(np.linalg.norm(params["place"] - truth["place"])) for params in (start, result.best_params)
)
print(f"off by {start_error:.1f} px at the start, {final_error:.3f} px at the end")
assert final_error < 0.1

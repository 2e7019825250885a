"""
Torch: the pose of a camera
===========================

The scene is fixed and the camera moves. Every entry of a scene can be a parameter by its name, such as the camera's
position and target: ``MeshRenderer.entries()`` lists them.
"""

import torch

from loi_core import Free, LOIObjective, ScaleSpace, fit
from loi_torch.mesh import Camera, Light, MeshRenderer, box
from pictures import Film

height, width = 60, 90
renderer = MeshRenderer(
    height,
    width,
    {
        "tower": box((0.8, 2.4, 0.8), (-0.7, 1.2, 0.0), colours=(0.8, 0.3, 0.2)),
        "hall": box((1.6, 0.9, 1.0), (0.6, 0.45, 0.2), colours=(0.9, 0.8, 0.5)),
        "shed": box((0.6, 0.5, 0.6), (0.2, 0.25, 1.2), colours=(0.3, 0.5, 0.8)),
    },
    Camera((4.0, 2.0, 9.0), fov=45.0),
    {"eye": "camera.position", "aim": "camera.target"},
    lights={"sun": Light(direction=(-1.0, -2.0, -3.0)), "sky": Light(colour=0.3)},
)
truth = {"eye": [2.5, 3.2, 7.5], "aim": [-2.2, 1.5, 0.0]}
start = {"eye": [-2.0, 1.5, 8.5], "aim": [2.6, 0.2, 0.0]}
photograph = renderer.render({name: torch.tensor(value, dtype=torch.float64) for name, value in truth.items()})

# %%
# The target of the camera is a point, which has no effect along the line of sight, so one of its coordinates is fixed.

objective = LOIObjective(photograph, ScaleSpace.for_image(height, width))
free = {
    "eye": Free(start["eye"], [-4.0, 0.5, 5.0], [4.0, 5.0, 10.0]),
    "aim": Free(start["aim"], [-4.0, -1.0, 0.0], [4.0, 3.0, 0.0]),
}
film = Film(photograph, linear=True)
result = fit(renderer, objective, steps=150, optimise=free, callback=film)
print(result.diagnosis)

# %%
film.show()

# %%
film.play()

# %%
solution = {name: value.tolist() for name, value in result.best_params.items()}
start_error, final_error = (
    float(torch.dist(torch.tensor(params["eye"]), torch.tensor(truth["eye"]))) for params in (start, solution)
)
print(f"the camera is off by {start_error:.2f} units at the start, {final_error:.3f} at the end")
assert final_error < 0.2

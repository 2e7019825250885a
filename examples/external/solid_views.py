"""A crate that moves and turns before four cameras, each with an exposure of its own."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from examples.external.counting import CountedRenderer, Tally
from examples.external.problem import Answer, Method, Problem, Start, Task, needs
from examples.external.solid_turns import host, parameters_like
from loi_core import Free, LOIObjective, PixelL2, Renderer, fit
from loi_core.objectives import Objective
from loi_core.renderers.contract import Parameters, Pullback
from loi_core.support.arrays import Array, Host, namespace, to_numpy
from loi_torch.mesh import Camera, Light, MeshRenderer, Rotate, Translate, box

__all__ = ["VIEWS", "Tiled"]

HEIGHT_PX, WIDTH_PX = 48, 64
CAMERA_DISTANCE: Final = 8.0
CAMERA_HEIGHT: Final = 3.0
AZIMUTHS: Final = (0.0, 80.0, 170.0, 260.0)  # degrees
EXPOSURES: Final = (0.7, 1.3)  # range of the gain of a view
OFFSETS: Final = (0.0, 0.05)  # range of the offset of a view
GROUNDS: Final = {"grey": 0.3, "black": 0.0}
PAINT: Final = ((0.8, 0.2, 0.1), (0.1, 0.5, 0.8), (0.8, 0.6, 0.1), (0.2, 0.6, 0.3), (0.5, 0.3, 0.7), (0.8, 0.8, 0.8))
REACH: Final = 1.5  # bound of each coordinate of the crate
TURN_BOUND: Final = 150.0  # degrees
MIN_TURN: Final = 60.0  # degrees, from start to goal


class Tiled:
    """Renderer of several views side by side, for methods that compare one image.

    Parameters
    ----------
    views : dict of Renderer
        Images of the same height.
    """

    def __init__(self, views: Mapping[str, Renderer]) -> None:
        self.views = dict(views)

    def parameters(self) -> Parameters:
        """Return the parameters, which all views share."""
        return next(iter(self.views.values())).parameters()

    def render(self, params: Parameters, *, seed: int = 0) -> Array:
        """Return the images side by side."""
        return _side_by_side([view.render(params, seed=seed) for view in self.views.values()])

    def render_vjp(self, params: Parameters, *, seed: int = 0) -> tuple[Array, Pullback]:
        """Return the images side by side, and their pullback."""
        images, pullbacks = zip(*(view.render_vjp(params, seed=seed) for view in self.views.values()), strict=True)

        def pullback(cotangent: Array) -> Parameters:
            total: Parameters = {}
            left = 0
            for image, pull in zip(images, pullbacks, strict=True):
                width = image.shape[1]
                for name, slope in pull(cotangent[:, left : left + width]).items():
                    total[name] = total[name] + slope if name in total else slope
                left += width
            return total

        return _side_by_side(images), pullback


def _side_by_side(images: Any) -> Array:
    return namespace(images[0]).concat(tuple(images), axis=1)


@dataclass(frozen=True)
class _Goal:
    place: Host
    turn: float

    def error(self, params: Mapping[str, Any]) -> float:
        """Return the largest of the turn that is left, and of the turn that an offset looks like from a camera."""
        turn = abs((float(host(params["turn"])) - self.turn + 180.0) % 360.0 - 180.0)
        return max(turn, float(np.degrees(np.linalg.norm(host(params["place"]) - self.place) / CAMERA_DISTANCE)))


def crate_in_four_views(ground: str, seed: int) -> Start:
    """Return a crate on plain ground whose four photographs have gains and offsets of their own."""
    rng = np.random.default_rng(seed)
    crate = box((1.8, 1.1, 0.8), colours=np.repeat(PAINT, 2, axis=0))
    whole = MeshRenderer(
        HEIGHT_PX,
        WIDTH_PX,
        {"crate": crate},
        Camera((0.0, CAMERA_HEIGHT, CAMERA_DISTANCE), fov=40.0),
        {"place": Translate("crate"), "turn": Rotate("crate", axis=(0, 1, 0))},
        lights={"sun": Light(direction=(-1.0, -2.0, -3.0), colour=0.8), "sky": Light(colour=0.4)},
        background=GROUNDS[ground],
    )
    tiled = Tiled({f"camera {degrees:.0f}": whole.with_camera(_camera(degrees)) for degrees in AZIMUTHS})
    start, goal = (rng.uniform(-0.8 * REACH, 0.8 * REACH, 3) for _ in range(2))
    while True:
        first, last = rng.uniform(-0.8 * TURN_BOUND, 0.8 * TURN_BOUND, 2)
        if abs(first - last) > MIN_TURN:
            break
    image = to_numpy(tiled.render(parameters_like(tiled.parameters(), {"place": goal, "turn": last})))
    gains, offsets = (
        np.repeat(rng.uniform(*limits, len(AZIMUTHS)), WIDTH_PX)[:, None] for limits in (EXPOSURES, OFFSETS)
    )
    free = {"place": Free(start, -REACH, REACH), "turn": Free(first, -TURN_BOUND, TURN_BOUND)}
    return Start(tiled, gains * image + offsets, free, _Goal(goal, last).error)


def _camera(degrees: float) -> Camera:
    azimuth = np.radians(degrees)
    position = (CAMERA_DISTANCE * np.sin(azimuth), CAMERA_HEIGHT, CAMERA_DISTANCE * np.cos(azimuth))
    return Camera(position, fov=40.0)


def _by_views(objective: Callable[[Host], Objective], task: Task) -> Answer:
    """Fit all views, each compared with its photograph; an image is one of all views."""
    tiled = task.start.renderer
    assert isinstance(tiled, Tiled)
    tally = Tally(lambda _: False)
    count = len(tiled.views)
    targets = np.split(task.start.target, count, axis=1)
    result = fit(
        {name: CountedRenderer(view, tally) for name, view in tiled.views.items()},
        {name: objective(target) for name, target in zip(tiled.views, targets, strict=True)},
        steps=task.problem.steps,
        seed=1000 * task.seed,
        optimise=task.start.free,
        callback=lambda *_: tally.renders >= count * task.problem.renders,
    )
    renders = round(tally.renders / count)
    diagnosis = result.diagnosis
    if diagnosis is None or objective is PixelL2:
        return Answer(result.best_params, renders=renders)
    return Answer(result.best_params, diagnosis.verdict, diagnosis.ok, renders)


def _matched(target: Host) -> Objective:
    exposure: dict[str, Any] = {"exposure": "matched"}
    return LOIObjective(target, **exposure)


def _without_matching() -> str:
    return "" if "exposure" in inspect.signature(LOIObjective).parameters else "needs `exposure` of LOIObjective"


VIEWS: Final = tuple(
    Problem(
        f"four views on {ground}, exposures",
        partial(crate_in_four_views, ground),
        "degrees",
        1.0,
        steps=200,
        renders=500,
        starts=4,
        source="a user of the library",
        licence="none needed",
        missing=needs("torch", "trimesh"),
        methods=(
            Method("loi, view by view", partial(_by_views, LOIObjective)),
            Method("loi, view by view, matched", partial(_by_views, _matched), _without_matching),
            Method("pixel L2, view by view", partial(_by_views, PixelL2)),
        ),
    )
    for ground in GROUNDS
)

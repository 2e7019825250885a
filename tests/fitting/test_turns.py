"""A fit finds rotations and cameras from far away, and keeps a start that is nearly right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, fit
from loi_core.renderers import Warp
from tests.contents import photograph
from tests.strategies import thorough

SIDE = 40
BOUND = 9.0
GOAL_DISTANCE = 3.0


class Camera:
    """A picture that a camera at ``position`` looks at from around it: its distance is the picture's size.

    Steps of one length move the image the more, the nearer the camera is.
    """

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        self.picture = Warp(photograph((17, 21, 3), rng), np.full((SIDE, SIDE, 3), 0.35))
        self.renders = 0

    def parameters(self) -> dict[str, Any]:
        return {"position": np.array([GOAL_DISTANCE, 0.0])}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        self.renders += 1
        x, y = params["position"]
        distance = max(float(np.hypot(x, y)), 1.0)
        pose = {"rotation": np.degrees(np.arctan2(y, x)), "scale": GOAL_DISTANCE / distance}
        image, pullback = self.picture.render_vjp(
            self.picture.parameters() | {name: np.asarray(value) for name, value in pose.items()}
        )

        def to_position(gradient: Any) -> dict[str, Any]:
            slopes = pullback(gradient)
            turn = float(slopes["rotation"]) * np.degrees(np.array([-y, x])) / distance**2
            return {"position": turn - float(slopes["scale"]) * GOAL_DISTANCE * np.array([x, y]) / distance**3}

        return image, to_position


def position(degrees: float, distance: float) -> Any:
    return distance * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


@pytest.mark.parametrize(
    ("degrees", "distance", "renders"),
    [
        (100.0, 8.0, 180),  # shorter steps suffice
        pytest.param(-130.0, 8.0, 180, marks=thorough),
        pytest.param(60.0, 3.0, 180, marks=thorough),
        (170.0, 5.0, 330),  # 100 steps, a race, and units
    ],
)
def test_a_camera_is_found_from_far_away_where_its_steps_are_long(
    degrees: float, distance: float, renders: int
) -> None:
    camera = Camera()
    target = camera.render({"position": position(20.0, GOAL_DISTANCE)})
    camera.renders = 0
    free = {"position": Free(position(20.0 + degrees, distance), -BOUND, BOUND)}
    result = fit(camera, LOIObjective(target), steps=100, optimise=free)
    assert np.hypot(*(result.best_params["position"] - position(20.0, GOAL_DISTANCE))) < 0.05
    assert camera.renders < renders


class Arm:
    """An arm of three links in the plane, each drawn as a row of spots; ``joints`` are in degrees."""

    COLOURS = np.array([[0.9, 0.4, 0.1], [0.2, 0.8, 0.3], [0.2, 0.3, 0.9]])
    SPOTS = np.linspace(0.2, 1.0, 5)
    LINK_PX, SPOT_PX = 11.0, 2.0

    def __init__(self) -> None:
        self.renders = 0
        self.grid = np.stack(np.meshgrid(np.arange(64) - 32.0, np.arange(48) - 40.0), axis=-1)

    def parameters(self) -> dict[str, Any]:
        return {"joints": np.zeros(3)}

    def render(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        return self.render_vjp(params, seed=seed)[0]

    def render_vjp(self, params: dict[str, Any], *, seed: int = 0) -> Any:
        self.renders += 1
        angles = np.radians(-90.0 + np.cumsum(params["joints"]))
        image, moved = np.full((48, 64, 3), 0.3), []
        origin, turned = np.zeros(2), np.zeros((3, 2))  # of the end of the last link, and its slopes
        for link, angle in enumerate(angles):
            along = self.LINK_PX * np.array([np.cos(angle), np.sin(angle)])
            across = np.outer(np.arange(3) <= link, [-along[1], along[0]])
            for share in self.SPOTS:
                offset = self.grid - (origin + share * along)
                spot = 0.4 * np.exp(-0.5 * np.sum(offset**2, axis=-1) / self.SPOT_PX**2)
                image += spot[..., None] * (self.COLOURS[link] - 0.3)
                slopes = spot[..., None] * offset @ (turned + share * across).T / self.SPOT_PX**2
                moved.append((slopes, self.COLOURS[link] - 0.3))
            origin, turned = origin + along, turned + across

        def to_joints(gradient: Any) -> dict[str, Any]:
            total = sum(np.einsum("hw,hwj->j", gradient @ colour, slopes) for slopes, colour in moved)
            return {"joints": np.radians(total)}

        return image, to_joints


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=thorough) for seed in (2, 3))])
def test_a_short_fit_of_an_arm_15_degrees_off_does_not_jump_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, goal = Arm(), rng.uniform(-40.0, 40.0, 3)
    target = arm.render({"joints": goal})
    arm.renders = 0
    free = {"joints": Free(goal + 15.0 * rng.choice([-1.0, 1.0], 3), -90.0, 90.0)}
    result = fit(arm, LOIObjective(target), steps=60, optimise=free)
    assert np.abs(result.best_params["joints"] - goal).max() < 3.0
    assert arm.renders < 120

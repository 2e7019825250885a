"""Several sensors of one Mitsuba scene can be fitted jointly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, ScaleSpace, fit

loi_mitsuba = pytest.importorskip("loi_mitsuba")
mi = pytest.importorskip("mitsuba")

GOAL = np.array([0.6, -0.4, 0.7], np.float32)


def scene() -> dict[str, Any]:
    """A ball before a white sky, with a sensor in front of the ball and one at its side."""

    def sensor(*origin: float) -> dict[str, Any]:
        view = mi.ScalarTransform4f().look_at(list(origin), [0, 0, 0], [0, 1, 0])
        film = {"type": "hdrfilm", "width": 48, "height": 36, "sample_border": True}
        return {"type": "perspective", "fov": 40, "to_world": view, "film": film}

    return {
        "type": "scene",
        "front": sensor(0.0, 0.0, 8.0),
        "side": sensor(8.0, 0.0, 0.0),
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "diffuse"}},
    }


def test_two_sensors_recover_the_depth_of_a_ball_with_one_render_per_step() -> None:
    views = {
        name: loi_mitsuba.MitsubaRenderer(scene(), {"place": loi_mitsuba.Translate("ball")}, spp=4, sensor=index)
        for index, name in enumerate(("front", "side"))
    }
    scales = ScaleSpace.for_image(36, 48, beta=0.25)
    objectives = {name: LOIObjective(view.render({"place": GOAL}, seed=100), scales) for name, view in views.items()}
    free = {"place": Free([-1.0, 0.8, -0.9], -1.5, 1.5)}
    result = fit(views, objectives, steps=100, learning_rate=0.1, optimise=free, views_per_step=1)
    np.testing.assert_allclose(result.best_params["place"], GOAL, atol=0.06)  # half a pixel

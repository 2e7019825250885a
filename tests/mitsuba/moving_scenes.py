"""Scenes with one moving shape, the gradient in a loop with ``mi.render``, and central differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tests.helpers import Host

__all__ = ["SCENES", "Agreement", "MovingScene", "flat_sided_box"]

WIDTH, HEIGHT = 48, 36
STEP: Final = 0.04  # of central differences
IMAGE_SAMPLES: Final = 1024
LAMP_RADIUS: Final = 4.0


class Agreement(NamedTuple):
    """The cosine between a gradient and central differences, and the ratio of their norms."""

    cosine: float
    norm: float


@dataclass(frozen=True)
class MovingScene:
    """A scene, and the entry that moves its shape named ``moving``.

    Attributes
    ----------
    build : callable
        Returns the scene's dict; it may write files to the folder that it is given.
    key : str
        Vertex positions, or a transform.
    report : str
        The issue on Mitsuba's tracker that reports a wrong gradient in such a scene, or "".
    """

    build: Callable[[Path], dict[str, Any]]
    key: str = "moving.vertex_positions"
    report: str = ""

    def agreement(self, folder: Path, integrators: list[dict[str, Any]], *, spp: int, seeds: int) -> list[Agreement]:
        """Compare the mean gradients of integrators, with respect to a translation, with central differences."""
        description = self.build(folder)
        scene = mi.load_dict(description)
        # Stratified samples: independent ones add an error of 3 % to central differences of edges.
        sampler = {"type": "multijitter", "sample_count": IMAGE_SAMPLES}
        camera = mi.load_dict(description["camera"] | {"sampler": sampler})
        params = mi.traverse(scene)
        start = dr.detach(params[self.key])

        def move(translation: Any) -> None:
            if isinstance(start, mi.Float):
                params[self.key] = dr.ravel(dr.unravel(mi.Point3f, start) + translation)
            else:
                params[self.key] = mi.Transform4f().translate(translation) @ mi.Transform4f(start)
            params.update()

        expected = [_central_difference(scene, camera, move, axis) for axis in range(3)]
        agreements = []
        for integrator in map(mi.load_dict, integrators):
            draws = []
            for seed in range(seeds):
                translation = mi.Point3f(0.0)
                dr.enable_grad(translation)
                move(translation)
                image = mi.render(scene, params, integrator=integrator, seed=seed, spp=spp)
                dr.backward(dr.sum(image * mi.TensorXf(_bump()), axis=None))
                draws.append(np.array(dr.grad(translation), dtype=np.float64).reshape(3))
            agreements.append(_agreement(np.mean(draws, axis=0), np.array(expected)))
        return agreements


def _central_difference(scene: Any, camera: Any, move: Callable[[Any], None], axis: int) -> float:
    losses = []
    for sign in (1.0, -1.0):
        move(mi.Point3f(*(sign * STEP * np.eye(3)[axis]).tolist()))
        path = mi.load_dict({"type": "path", "max_depth": 2})
        image = mi.render(scene, sensor=camera, integrator=path, spp=IMAGE_SAMPLES, seed=3)
        losses.append(float(np.sum(np.array(image, dtype=np.float64) * _bump())))
    return (losses[0] - losses[1]) / (2.0 * STEP)


def _agreement(gradient: Host, expected: Host) -> Agreement:
    size, expected_size = np.linalg.norm(gradient), np.linalg.norm(expected)
    return Agreement(float(gradient @ expected / (size * expected_size)), float(size / expected_size))


def _bump() -> Host:
    """A cotangent of the image that is concentrated on one side of the shape."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    weight = np.exp(-((columns - 28.0) ** 2 + (rows - 18.0) ** 2) / 80.0)
    return np.asarray(weight[..., None] * np.array([1.0, 0.5, -0.5]), dtype=np.float32)


def flat_sided_box(path: Path) -> None:
    """Write the OBJ file of a box with one normal per side, whose vertices Mitsuba therefore stores three times."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    sides = {
        (-1, 0, 0): (0, 1, 3, 2),
        (1, 0, 0): (4, 6, 7, 5),
        (0, -1, 0): (0, 4, 5, 1),
        (0, 1, 0): (2, 3, 7, 6),
        (0, 0, -1): (0, 2, 6, 4),
        (0, 0, 1): (1, 5, 7, 3),
    }
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"vn {x} {y} {z}" for x, y, z in sides]
    for side, quad in enumerate(sides.values(), start=1):
        a, b, c, d = (f"{corner + 1}//{side}" for corner in quad)
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    path.write_text("\n".join(lines) + "\n")


def _lit(**shapes: Any) -> dict[str, Any]:
    transform = mi.ScalarTransform4f
    return {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "fov": 40,
            "to_world": transform().look_at([3, 4, 6], [0, 0.5, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "sample_border": True},
        },
        "lamp": {
            "type": "sphere",
            "center": [4, 9, 3],
            "radius": LAMP_RADIUS,
            "emitter": {"type": "area", "radiance": 3.0},
        },
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(20)},
        **shapes,
    }


def _coloured(*colour: float) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}}


def _obj(folder: Path) -> dict[str, Any]:
    path = folder / "box.obj"
    flat_sided_box(path)
    pose = mi.ScalarTransform4f().translate([0, 1.2, 0]).scale(0.7)
    return {"type": "obj", "filename": str(path), "to_world": pose, "bsdf": _coloured(0.7, 0.2, 0.1)}


def _box_over_floor(folder: Path) -> dict[str, Any]:
    return _lit(moving=_obj(folder))


def _cube_in_a_sky(_: Path) -> dict[str, Any]:
    """Return a mesh under constant light, where only the outline of the mesh has a gradient."""
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0.5, 0]).scale(0.6)}
    scene = _lit(moving=cube) | {"lamp": {"type": "constant", "radiance": 1.0}}
    del scene["floor"]
    return scene


def _rectangle_before_wall(folder: Path) -> dict[str, Any]:
    transform = mi.ScalarTransform4f
    pose = transform().translate([0, 1, 0]).rotate([0.3, 1, 0], 40).scale([0.8, 0.6, 1])
    wall = {"type": "rectangle", "to_world": transform().translate([0, 0, -2]).scale(20)}
    return _lit(moving={"type": "rectangle", "to_world": pose, "bsdf": _coloured(0.7, 0.2, 0.1)}, wall=wall)


def _interpenetrating_boxes(folder: Path) -> dict[str, Any]:
    pose = mi.ScalarTransform4f().translate([0.6, 1.0, 0.5]).rotate([0.2, 1, 0], 30).scale(0.6)
    return _lit(moving=_obj(folder), other={"type": "cube", "to_world": pose, "bsdf": _coloured(0.1, 0.3, 0.6)})


def _shadowed_box(folder: Path) -> dict[str, Any]:
    occluder = {"type": "sphere", "center": [1.2, 3.2, 0.9], "radius": 0.5, "bsdf": _coloured(0.1, 0.3, 0.6)}
    return _lit(moving=_obj(folder), occluder=occluder)


def _under(light: dict[str, Any], **shapes: Any) -> dict[str, Any]:
    """Return a scene with another light, and a little light from everywhere."""
    return _lit(**shapes) | {"lamp": light, "sky": {"type": "constant", "radiance": 0.1}}


def _box_under_a_point_light(folder: Path) -> dict[str, Any]:
    ball = {"type": "sphere", "center": [-0.9, 0.4, 0.6], "radius": 0.4, "bsdf": _coloured(0.1, 0.3, 0.6)}
    return _under({"type": "point", "position": [2.0, 6.0, 2.0], "intensity": 60.0}, moving=_obj(folder), ball=ball)


def _ball_out_of_view(_: Path) -> dict[str, Any]:
    """Return a scene where the shadow moves twice as fast as the ball, which is as far from the light as from it."""
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0.2, 5.0, 0.0]).scale(0.4)}
    return _under({"type": "point", "position": [0.5, 9.5, 0.3], "intensity": 150.0}, moving=ball)


def _ball_in_the_sun(folder: Path) -> dict[str, Any]:
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0.0, 1.2, 0.0]).scale(0.7)}
    occluder = {"type": "sphere", "center": [1.0, 3.0, 0.6], "radius": 0.4, "bsdf": _coloured(0.1, 0.3, 0.6)}
    return _under(
        {"type": "directional", "direction": [-0.4, -1.0, -0.3], "irradiance": 2.0}, moving=ball, occluder=occluder
    )


def _box_under_a_spot(folder: Path) -> dict[str, Any]:
    pose = mi.ScalarTransform4f().look_at([2.0, 6.0, 2.0], [0.3, 0.0, 0.0], [0.0, 0.0, 1.0])
    return _under({"type": "spot", "to_world": pose, "intensity": 60.0, "cutoff_angle": 25.0}, moving=_obj(folder))


SCENES: Final = {
    "cube under a uniform sky": MovingScene(_cube_in_a_sky, report="mitsuba3#1895"),
    "flat-sided OBJ over a floor": MovingScene(_box_over_floor, report="mitsuba3#1648"),
    "leaning rectangle before a wall": MovingScene(_rectangle_before_wall, "moving.to_world"),
    "two boxes that intersect": MovingScene(_interpenetrating_boxes),
    "box that moves through a shadow": MovingScene(_shadowed_box),
    "box and its shadow under a point light": MovingScene(_box_under_a_point_light, report="mitsuba3#1585"),
    "shadow of a ball out of view under a point light": MovingScene(
        _ball_out_of_view, "moving.to_world", "mitsuba3#1585"
    ),
    "ball that moves through a shadow in the sun": MovingScene(_ball_in_the_sun, "moving.to_world"),
    "box in the cone of a spot": MovingScene(_box_under_a_spot, report="mitsuba3#1443"),
}

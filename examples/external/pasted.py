"""Pictures pasted on photographs: place, turn and size free, from afar and from half a pixel off."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from PIL import Image, ImageFilter

from examples.external.photographs import NAMES, crop_of
from examples.external.problem import Problem, Start, bound_error, corner_error, needs
from loi_core import Free
from loi_core.renderers import Warp
from loi_core.support.arrays import Host

__all__ = ["PASTED", "POSES"]

HEIGHT_PX, WIDTH_PX = 96, 128
SIDE_PX: Final = 36
MARGIN_PX: Final = 20.0
MIN_DISTANCE_PX: Final = 25.0  # from start to goal
MAX_TURN: Final = 30.0  # degrees
SIZES: Final = (0.8, 1.25)
TURN_BOUND: Final = 60.0  # degrees
SIZE_BOUNDS: Final = (0.6, 1.6)
GROUND_OFFSET: Final = 7  # places in the list of photographs from a picture to its ground
NOISE: Final = 0.02  # standard deviation
JPEG_QUALITY: Final = 60
GROUND_GAIN: Final = 1.15
GROUND_SHIFT_PX: Final = 2
HAND_PX: Final = 18
HALF_PIXEL_PX: Final = 0.5

Random = np.random.Generator


@dataclass(frozen=True)
class _Scene:
    """A picture on a ground; a photograph of it may show another ground."""

    picture: Host
    ground: Host
    goal: dict[str, Host]
    rng: Random

    def photograph(self, ground: Host | None = None) -> Host:
        """Return the picture at its goal on a ground."""
        renderer = Warp(self.picture, self.ground if ground is None else ground)
        return renderer.render(renderer.parameters() | self.goal)


def _clean(scene: _Scene) -> Host:
    return scene.photograph()


def _darker(gain: float, scene: _Scene) -> Host:
    return gain * scene.photograph()


def _noisy(image: Host, rng: Random) -> Host:
    return np.clip(image + NOISE * rng.standard_normal(image.shape), 0.0, 1.0)


def _spoiled(scene: _Scene) -> Host:
    """Return a photograph with exposure, noise and JPEG, on a ground in other light and out of register."""
    ground = np.clip(GROUND_GAIN * np.roll(scene.ground, GROUND_SHIFT_PX, axis=(0, 1)), 0.0, 1.0)
    noisy = _noisy(0.8 * scene.photograph(ground), scene.rng)
    stream = io.BytesIO()
    Image.fromarray(np.rint(255.0 * noisy).astype(np.uint8)).save(stream, "JPEG", quality=JPEG_QUALITY)
    with Image.open(stream) as stored:
        return np.asarray(stored.convert("RGB"), dtype=np.float64) / 255.0


def _hand(scene: _Scene) -> Host:
    """Return a photograph with a foreign patch over a corner of the picture."""
    image, centre = scene.photograph(), scene.goal["translation"] + 0.5 * np.array([WIDTH_PX, HEIGHT_PX])
    column, row = np.rint(centre).astype(int)
    colour = scene.rng.uniform(0.2, 0.9, 3)
    image[max(row, 0) : row + HAND_PX, max(column, 0) : column + HAND_PX] = colour
    return image


def _blurred(scene: _Scene) -> Host:
    image = Image.fromarray(np.rint(255.0 * scene.photograph()).astype(np.uint8)).filter(ImageFilter.GaussianBlur(1.0))
    return _noisy(np.asarray(image, dtype=np.float64) / 255.0, scene.rng)


def _pasted(photographed: Callable[[_Scene], Host], seed: int) -> Start:
    rng = np.random.default_rng(seed)
    picture, ground = _contents(seed, rng)
    half = 0.5 * np.array([WIDTH_PX, HEIGHT_PX]) - MARGIN_PX
    while True:
        start, goal = rng.uniform(-half, half), rng.uniform(-half, half)
        if np.hypot(*(goal - start)) >= MIN_DISTANCE_PX:
            break
    pose = {
        "translation": goal,
        "rotation": np.asarray(rng.uniform(-MAX_TURN, MAX_TURN)),
        "scale": np.asarray(np.exp(rng.uniform(*np.log(SIZES)))),
    }
    first = {"translation": start, "rotation": np.asarray(0.0), "scale": np.asarray(1.0)}
    return _start(_Scene(picture, ground, pose, rng), first, half, photographed)


def _half_a_pixel_off(photographed: Callable[[_Scene], Host], seed: int) -> Start:
    rng = np.random.default_rng(seed)
    picture, ground = _contents(seed, rng)
    half = 0.5 * np.array([WIDTH_PX, HEIGHT_PX]) - MARGIN_PX
    goal, angle = rng.uniform(-0.5 * half, 0.5 * half), rng.uniform(0.0, 2.0 * np.pi)
    rotation, size = np.asarray(rng.uniform(-MAX_TURN, MAX_TURN)), np.asarray(np.exp(rng.uniform(*np.log(SIZES))))
    start = goal + HALF_PIXEL_PX * np.array([np.cos(angle), np.sin(angle)])
    pose = {"translation": goal, "rotation": rotation, "scale": size}
    return _start(_Scene(picture, ground, pose, rng), pose | {"translation": start}, half, photographed)


def _contents(seed: int, rng: Random) -> tuple[Host, Host]:
    picture, ground = (NAMES[(seed + offset) % len(NAMES)] for offset in (0, GROUND_OFFSET))
    return crop_of(picture, SIDE_PX, SIDE_PX, rng), crop_of(ground, HEIGHT_PX, WIDTH_PX, rng)


def _start(scene: _Scene, first: dict[str, Host], half: Host, photographed: Callable[[_Scene], Host]) -> Start:
    free = {
        "translation": Free(first["translation"], -half, half),
        "rotation": Free(first["rotation"], -TURN_BOUND, TURN_BOUND),
        "scale": Free(first["scale"], *SIZE_BOUNDS),
    }
    error = bound_error(corner_error, (SIDE_PX, SIDE_PX), scene.goal)
    return Start(Warp(scene.picture, scene.ground), photographed(scene), free, error)


def _problem(
    name: str,
    make: Callable[[Callable[[_Scene], Host], int], Start],
    photographed: Callable[[_Scene], Host],
    *,
    tolerance: float,
    starts: int,
) -> Problem:
    return Problem(
        name,
        partial(make, photographed),
        "px",
        tolerance,
        steps=200,
        renders=400,
        starts=starts,
        source="users of the library; photographs of scikit-image",
        licence="see skimage.data; no file is copied",
        missing=needs("skimage"),
    )


PASTED: Final = (
    _problem("pasted picture, clean", _pasted, _clean, tolerance=1.0, starts=12),
    _problem("pasted picture, x 0.8", _pasted, partial(_darker, 0.8), tolerance=1.0, starts=12),
    _problem("pasted picture, spoiled", _pasted, _spoiled, tolerance=1.0, starts=12),
)

POSES: Final = (
    _problem("half a pixel off, equal", _half_a_pixel_off, _clean, tolerance=0.05, starts=6),
    _problem("half a pixel off, x 0.97", _half_a_pixel_off, partial(_darker, 0.97), tolerance=0.05, starts=6),
    _problem("half a pixel off, x 0.9", _half_a_pixel_off, partial(_darker, 0.9), tolerance=0.05, starts=6),
    _problem("half a pixel off, a hand", _half_a_pixel_off, _hand, tolerance=0.2, starts=6),
    _problem("half a pixel off, blur and noise", _half_a_pixel_off, _blurred, tolerance=0.05, starts=6),
)

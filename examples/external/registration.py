"""Photographs shifted against each other: registrations by kornia, by matching, and by the library's fit."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final, Literal

import numpy as np

from examples.external.photographs import NAMES, image_of
from examples.external.problem import Answer, Method, Problem, Start, Task, needs
from loi_core import Free
from loi_core.renderers import Warp
from loi_core.support.arrays import Host, to_numpy

__all__ = ["REGISTRATIONS"]

SIDE_PX: Final = 96
SHORTER_SIDE_PX: Final = 160  # of the photograph that both crops are taken from
BOUND: Final = 0.7  # of the side
SHIFTS: Final = (0.1, 0.25, 0.4, 0.5, 0.6)  # of the side
AGREEMENT_PX: Final = 2.0  # between matches of one shift
SUBPIXELS: Final = 20

Loss = Literal["L1", "loi"]
Settings = Literal["default", "tuned", "searched"]


def _make(share: float, seed: int) -> Start:
    """Return two crops of a photograph; the renderer moves the first over the second."""
    rng = np.random.default_rng(seed)
    whole = image_of(NAMES[seed % len(NAMES)])
    factor = SHORTER_SIDE_PX / min(whole.size)
    whole = whole.resize((round(factor * whole.width), round(factor * whole.height)))
    pixels = np.asarray(whole, dtype=np.float64) / 255.0
    angle = rng.uniform(0.0, 2.0 * np.pi)
    shift = np.rint(share * SIDE_PX * np.array([np.cos(angle), np.sin(angle)])).astype(int)
    first_corner = np.maximum(-shift, 0)
    last_corner = np.array(whole.size) - SIDE_PX - np.maximum(shift, 0)
    first = rng.integers(first_corner, last_corner + 1)
    moving, target = (_crop(pixels, corner) for corner in (first, first + shift))
    bound = np.full(2, BOUND * SIDE_PX)
    free = {"translation": Free(np.zeros(2), -bound, bound)}
    return Start(Warp(moving, target), target, free, partial(_distance, -shift.astype(np.float64)), moving)


def _crop(pixels: Host, corner: Host) -> Host:
    column, row = corner
    return pixels[row : row + SIDE_PX, column : column + SIDE_PX].copy()


def _distance(goal: Host, params: Mapping[str, Any]) -> float:
    return float(np.hypot(*(np.asarray(to_numpy(params["translation"])) - goal)))


def _grey_pair(task: Task) -> tuple[Host, Host]:
    assert task.start.moving is not None
    return task.start.moving.mean(axis=-1), task.start.target.mean(axis=-1)


def _phase_correlation(task: Task) -> Answer:
    from skimage.registration import phase_cross_correlation

    moving, target = _grey_pair(task)
    rows, columns = phase_cross_correlation(target, moving, upsample_factor=SUBPIXELS)[0]
    return Answer({"translation": np.array([columns, rows])})


def _sift(task: Task) -> Answer:
    """Return the shift that most matches of SIFT features agree on; the start if there are none."""
    from skimage.feature import SIFT, match_descriptors

    points, descriptors = [], []
    for image in _grey_pair(task):
        features = SIFT()
        try:
            features.detect_and_extract(image)
        except RuntimeError:  # no features
            return Answer({"translation": np.zeros(2)})
        points.append(features.keypoints)
        descriptors.append(features.descriptors)
    matches = match_descriptors(*descriptors, max_ratio=0.8, cross_check=True)
    if not len(matches):
        return Answer({"translation": np.zeros(2)})
    shifts = (points[1][matches[:, 1]] - points[0][matches[:, 0]])[:, ::-1]
    agreeing = np.hypot(*np.moveaxis(shifts[:, None] - shifts[None, :], -1, 0)) <= AGREEMENT_PX
    return Answer({"translation": shifts[agreeing[np.argmax(agreeing.sum(axis=1))]].mean(axis=0)})


def _kornia(loss: Loss, settings: Settings, task: Task) -> Answer:
    from examples.external.registrators import register

    assert task.start.moving is not None
    translation, images = register(task.start.moving, task.start.target, loss, settings)
    return Answer({"translation": translation}, renders=images)


METHODS: Final = (
    Method("kornia", partial(_kornia, "L1", "default"), needs("kornia")),
    Method("kornia, tuned", partial(_kornia, "L1", "tuned"), needs("kornia")),
    Method("kornia, tuned, loi", partial(_kornia, "loi", "tuned"), needs("kornia")),
    Method("kornia, searched", partial(_kornia, "L1", "searched"), needs("kornia")),
    Method("kornia, searched, loi", partial(_kornia, "loi", "searched"), needs("kornia")),
    Method("phase correlation", _phase_correlation, needs("skimage")),
    Method("SIFT", _sift, needs("skimage")),
)

REGISTRATIONS: Final = tuple(
    Problem(
        f"photographs shifted by {share:g}",
        partial(_make, share),
        "px",
        1.0,
        steps=200,
        renders=400,  # kornia's are 1000 at most, most of them small
        starts=12,
        source="kornia, ImageRegistrator; photographs of scikit-image",
        licence="see skimage.data; no file is copied",
        missing=needs("skimage"),
        methods=METHODS,
    )
    for share in SHIFTS
)

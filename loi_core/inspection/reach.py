"""How far each scale reaches: measured with a small object, and with the picture itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.inspection.pair import averaged, moved, shrunk_scales
from loi_core.io.images import FloatImage
from loi_core.method.comparison import ScaleKey
from loi_core.method.scales import ScaleSpace
from loi_core.objectives.loi import LOIObjective

__all__ = ["FAINTEST", "OBJECT", "Reach", "Shifts", "furthest_rise", "reach_of_object", "shifts_of_picture"]

FAINTEST: Final = 0.01
"""The slope of the loss that still counts, of its steepest."""

OBJECT: Final = 0.02  # radius of the object, of the longer side
PLACE: Final = 0.125  # where it is in the reference, of the longer side
FARTHEST: Final = 0.75  # how far it is moved away, of the longer side
LONGEST: Final = 256  # side of the frame that is measured on, in pixels
LONGEST_PICTURE: Final = 160  # and of the picture, which is compared at four times as many places
RATIO: Final = 1.25  # of a distance to the one before
HALF: Final = 0.5  # of the shorter side: how far a picture is moved against itself


@dataclass(frozen=True)
class Reach:
    """How far something may be away and is still drawn back.

    Attributes
    ----------
    distance : float
        In pixels of the files.
    at_least : bool
        Whether that is as far as was tried, so that it may reach farther.
    """

    distance: float
    at_least: bool

    def __str__(self) -> str:
        number = f"{self.distance:.0f}" if self.distance >= 10.0 else f"{self.distance:.2g}"
        return f"{number} px{' or more' if self.at_least else ''}"


@dataclass(frozen=True)
class Shifts:
    """The loss of a picture that is moved against itself.

    Attributes
    ----------
    distances : tuple of float
        In pixels of the files, from 0 on.
    values : dict
        What each scale adds to the loss there, the mean over shifts to the left, right, top and bottom.
    rises : dict
        How far the loss rises all the way, for each scale.
    """

    distances: tuple[float, ...]
    values: dict[ScaleKey, tuple[float, ...]]
    rises: dict[ScaleKey, Reach]


def reach_of_object(scales: ScaleSpace, height: int, width: int) -> dict[ScaleKey, Reach]:
    """How far away a small object may be and is still drawn to its place, for each scale alone.

    A bright disk, with a radius of 2 % of the longer side, lies on a flat frame of the images' size, an eighth of it
    from one end. The same disk is moved away from there along the longer side. As long as the loss rises with the
    distance, its gradient points back. The reach is the distance up to which the loss rises by 1 % or more of its
    steepest rise at every step.

    Parameters
    ----------
    scales : ScaleSpace
        In pixels of the files.
    height, width : int
        Of the files, in pixels. Large frames are measured at a fraction of their size, of 256 pixels at most.
    """
    longer, shorter = max(height, width), min(height, width)
    factor = math.ceil(longer / LONGEST)
    size = max(1, shorter // factor), max(1, longer // factor)
    radius = max(1.0, OBJECT * size[1])

    def frame(distance: int) -> FloatImage:
        rows, columns = np.indices(size)
        away = np.hypot(rows - (size[0] - 1) / 2, columns - round(PLACE * size[1]) - distance)
        low, high = scales.bounds
        inside = np.clip(radius + 0.5 - away, 0.0, 1.0)
        shown: FloatImage = low + (high - low) * (0.5 + 0.25 * inside)
        return shown[..., None]

    distances = _distances(round(FARTHEST * size[1]))
    values = _values(frame(0), shrunk_scales(scales, factor), distances, lambda distance: [frame(distance)])
    lengths = [factor * distance for distance in distances]
    return {key: furthest_rise(lengths, values[:, index]) for index, key in enumerate(scales.keys)}


def shifts_of_picture(reference: FloatImage, scales: ScaleSpace, factor: int) -> Shifts:
    """How the loss grows as a picture is moved against itself, for each scale.

    What comes in at an edge is the edge. The distances go up to half the shorter side.

    Parameters
    ----------
    reference : array, shape (h, w, C), float64
        Averaged over `factor` x `factor` pixels of the file; it is averaged on to 160 pixels at most.
    scales : ScaleSpace
        In pixels of the file.
    factor : int
    """
    further = math.ceil(max(reference.shape[:2]) / LONGEST_PICTURE)
    picture, total = averaged(reference, further), factor * further
    distances = _distances(max(1, round(HALF * min(picture.shape[:2]))))

    def ways(distance: int) -> list[FloatImage]:
        return [moved(picture, *way) for way in ((0, distance), (0, -distance), (distance, 0), (-distance, 0))]

    values = _values(picture, shrunk_scales(scales, total), distances, ways)
    lengths = [float(total * distance) for distance in distances]
    columns = {key: values[:, index] for index, key in enumerate(scales.keys)}
    return Shifts(
        tuple(lengths),
        {key: tuple(map(float, column)) for key, column in columns.items()},
        {key: furthest_rise(lengths, column) for key, column in columns.items()},
    )


def furthest_rise(distances: Sequence[float], values: FloatImage) -> Reach:
    """The distance up to which values rise by at least 1 % of their steepest rise at every step; 0 if they never do."""
    slopes = np.diff(values) / np.diff(distances)
    least = FAINTEST * float(np.max(slopes))
    if least <= 0.0:
        return Reach(0.0, at_least=False)
    faint = np.flatnonzero(slopes < least)
    if len(faint) == 0:
        return Reach(float(distances[-1]), at_least=True)
    end = int(faint[0])
    middles = 0.5 * (np.asarray(distances[1:]) + np.asarray(distances[:-1]))
    if end == 0:
        return Reach(0.0, at_least=False)
    part = (slopes[end - 1] - least) / (slopes[end - 1] - slopes[end])
    return Reach(float(middles[end - 1] + part * (middles[end] - middles[end - 1])), at_least=False)


def _distances(farthest: int) -> list[int]:
    """Whole numbers of pixels from 0 on, each some 25 % more than the one before."""
    found = [0]
    while found[-1] < farthest:
        found.append(min(farthest, max(found[-1] + 1, round(RATIO * found[-1]))))
    return found


def _values(
    reference: FloatImage, scales: ScaleSpace, distances: list[int], images: Callable[[int], list[FloatImage]]
) -> FloatImage:
    """What each scale adds to the loss at each distance, the mean over the images there; shape (distances, scales)."""
    objective = LOIObjective(reference, scales)
    rows = []
    for distance in distances:
        terms = [objective.terms(image) for image in images(distance)]
        rows.append([np.mean([float(each[key]) for each in terms]) for key in scales.keys])
    return np.array(rows)

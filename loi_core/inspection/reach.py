"""The reach of each scale, measured with a small object and with the image itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from loi_core.inspection.pair import averaged, scaled_down, shifted
from loi_core.io.images import FloatImage
from loi_core.method.comparison import ScaleKey
from loi_core.method.scales import ScaleSpace
from loi_core.objectives.loi import LOIObjective

__all__ = ["MIN_RELATIVE_SLOPE", "Reach", "Shifts", "furthest_rise", "reach_of_object", "shifts_of_picture"]

MIN_RELATIVE_SLOPE: Final = 0.01
"""The slope of the loss, relative to its steepest, at which the reach ends."""

OBJECT_RADIUS: Final = 0.02  # of the longer side
OBJECT_POSITION: Final = 0.125  # of the longer side, from one end
MAX_OBJECT_SHIFT: Final = 0.75  # of the longer side
MAX_IMAGE_SHIFT: Final = 0.5  # of the shorter side
FRAME_SIDE_PX: Final = 256  # longer side of the frame with the object
IMAGE_SIDE_PX: Final = 160  # longer side of the shifted image, which is compared at four times as many positions
DISTANCE_RATIO: Final = 1.25  # of a distance to the one before


@dataclass(frozen=True)
class Reach:
    """The largest distance of an object that is still drawn back.

    Attributes
    ----------
    distance : float
        In pixels of the files.
    at_least : bool
        Whether `distance` is the largest that was tried, so that the reach may be longer.
    """

    distance: float
    at_least: bool

    def __str__(self) -> str:
        number = f"{self.distance:.0f}" if self.distance >= 10.0 else f"{self.distance:.2g}"
        return f"{number} px{' or more' if self.at_least else ''}"


@dataclass(frozen=True)
class Shifts:
    """The loss of an image that is shifted against itself.

    Attributes
    ----------
    distances : tuple of float
        In pixels of the files, from 0 on.
    values : dict
        The contribution of each scale to the loss there, the mean over shifts left, right, up and down.
    rises : dict
        How far the loss of each scale rises.
    """

    distances: tuple[float, ...]
    values: dict[ScaleKey, tuple[float, ...]]
    rises: dict[ScaleKey, Reach]


def reach_of_object(scales: ScaleSpace, height: int, width: int) -> dict[ScaleKey, Reach]:
    """Return the largest distance of a small object that each scale alone still draws back.

    A bright disk, with a radius of 2 % of the longer side, lies on a flat frame of the images' size, an eighth of the
    longer side from one end. The same disk is moved away along the longer side. As long as the loss rises with the
    distance, its gradient points back. Up to the reach, the loss rises by 1 % or more of its
    steepest rise at every step.

    Parameters
    ----------
    scales : ScaleSpace
        In pixels of the files.
    height, width : int
        In pixels of the files. Large frames are measured at a fraction of their size, of 256 pixels at most.
    """
    longer, shorter = max(height, width), min(height, width)
    factor = math.ceil(longer / FRAME_SIDE_PX)
    size = max(1, shorter // factor), max(1, longer // factor)
    radius = max(1.0, OBJECT_RADIUS * size[1])

    def frame(distance: int) -> FloatImage:
        rows, columns = np.indices(size)
        from_centre = np.hypot(rows - (size[0] - 1) / 2, columns - round(OBJECT_POSITION * size[1]) - distance)
        lower, upper = scales.bounds
        coverage = np.clip(radius + 0.5 - from_centre, 0.0, 1.0)
        image: FloatImage = lower + (upper - lower) * (0.5 + 0.25 * coverage)
        return image[..., None]

    distances = _distances(round(MAX_OBJECT_SHIFT * size[1]))
    values = _values(frame(0), scaled_down(scales, factor), distances, lambda distance: [frame(distance)])
    lengths = [factor * distance for distance in distances]
    return {key: furthest_rise(lengths, values[:, index]) for index, key in enumerate(scales.keys)}


def shifts_of_picture(reference: FloatImage, scales: ScaleSpace, factor: int) -> Shifts:
    """Return the loss of each scale as an image is shifted against itself, up to half its shorter side.

    The pixels at an edge are repeated.

    Parameters
    ----------
    reference : array, shape (h, w, C), float64
        Averaged over `factor` x `factor` pixels of the file; it is averaged further, to at most 160 pixels.
    scales : ScaleSpace
        In pixels of the file.
    factor : int
    """
    further = math.ceil(max(reference.shape[:2]) / IMAGE_SIDE_PX)
    image, total = averaged(reference, further), factor * further
    distances = _distances(max(1, round(MAX_IMAGE_SHIFT * min(image.shape[:2]))))

    def shifts(distance: int) -> list[FloatImage]:
        return [shifted(image, *step) for step in ((0, distance), (0, -distance), (distance, 0), (-distance, 0))]

    values = _values(image, scaled_down(scales, total), distances, shifts)
    lengths = [float(total * distance) for distance in distances]
    columns = {key: values[:, index] for index, key in enumerate(scales.keys)}
    return Shifts(
        tuple(lengths),
        {key: tuple(map(float, column)) for key, column in columns.items()},
        {key: furthest_rise(lengths, column) for key, column in columns.items()},
    )


def furthest_rise(distances: Sequence[float], values: FloatImage) -> Reach:
    """Return how far values rise by 1 % or more of their steepest rise at every step; 0 if they never do."""
    slopes = np.diff(values) / np.diff(distances)
    minimum = MIN_RELATIVE_SLOPE * float(np.max(slopes))
    if minimum <= 0.0:
        return Reach(0.0, at_least=False)
    flat = np.flatnonzero(slopes < minimum)
    if len(flat) == 0:
        return Reach(float(distances[-1]), at_least=True)
    first = int(flat[0])
    if first == 0:
        return Reach(0.0, at_least=False)
    middles = 0.5 * (np.asarray(distances[1:]) + np.asarray(distances[:-1]))
    weight = (slopes[first - 1] - minimum) / (slopes[first - 1] - slopes[first])
    return Reach(float(middles[first - 1] + weight * (middles[first] - middles[first - 1])), at_least=False)


def _distances(largest: int) -> list[int]:
    """Return whole numbers of pixels from 0 on, each some 25 % larger than the one before."""
    distances = [0]
    while distances[-1] < largest:
        distances.append(min(largest, max(distances[-1] + 1, round(DISTANCE_RATIO * distances[-1]))))
    return distances


def _values(
    reference: FloatImage, scales: ScaleSpace, distances: list[int], images: Callable[[int], list[FloatImage]]
) -> FloatImage:
    """Return the contribution of each scale at each distance, the mean over its images; shape (distances, scales)."""
    objective = LOIObjective(reference, scales)
    rows = []
    for distance in distances:
        terms = [objective.terms(image) for image in images(distance)]
        rows.append([np.mean([float(values[key]) for values in terms]) for key in scales.keys])
    return np.array(rows)

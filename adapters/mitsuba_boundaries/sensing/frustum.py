"""The view frustum of a perspective camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from mitsuba_boundaries.geometry.bounds import bounding_box
from mitsuba_boundaries.sensing.sensor import principal_point_offset

__all__ = ["Frustum"]


class Frustum:
    """The view frustum of a sensor.

    Parameters
    ----------
    sensor : mi.Sensor
        Only perspective cameras have a known frustum.
    """

    def __init__(self, sensor: Any) -> None:
        self._to_film: Any = None
        if sensor.class_name() == "PerspectiveCamera":
            self._to_film = _matrix(sensor.projection_transform()) @ np.linalg.inv(_matrix(sensor.world_transform()))
            self._offset = principal_point_offset(sensor)

    def overlaps(self, shape: Any) -> bool:
        """Return whether the bounding box of a shape may overlap the frustum; True for other than perspective cameras.

        The test is conservative: False only if all corners of the box lie beyond one plane of the frustum.
        """
        if self._to_film is None:
            return True
        lower, upper = bounding_box(shape)
        corners = np.array(
            [[x, y, z, 1.0] for x in (lower[0], upper[0]) for y in (lower[1], upper[1]) for z in (lower[2], upper[2])]
        )
        x, y, _, w = self._to_film @ corners.T
        x, y = (coordinate - offset * w for coordinate, offset in zip((x, y), self._offset, strict=True))
        # Homogeneous coordinates: a corner behind the camera has w < 0, and the inequalities still hold.
        is_outside = (x < 0.0, x > w, y < 0.0, y > w, w < 0.0)
        return not any(bool(np.all(plane)) for plane in is_outside)


def _matrix(transform: Any) -> Any:
    return np.array(transform.matrix, dtype=np.float64).reshape(4, 4)

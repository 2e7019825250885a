"""The view frustum of a perspective camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from loi_mitsuba.geometry.bounds import bounding_box
from loi_mitsuba.sensing.sensor import principal_point_offset

__all__ = ["Frustum"]


class Frustum:
    """What a perspective camera sees.

    Parameters
    ----------
    sensor : mi.Sensor
        What any other sees is not known.
    """

    def __init__(self, sensor: Any) -> None:
        self._to_film: Any = None
        if sensor.class_name() == "PerspectiveCamera":
            self._to_film = _matrix(sensor.projection_transform()) @ np.linalg.inv(_matrix(sensor.world_transform()))
            self._offset = principal_point_offset(sensor)

    def overlaps(self, shape: Any) -> bool:
        """Whether the box around a shape reaches into the view; True if that is not known.

        No corner of the box beyond one side of the pyramid of view is the only case in which it surely does not.
        """
        if self._to_film is None:
            return True
        low, high = bounding_box(shape)
        corners = np.array(
            [[x, y, z, 1.0] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        )
        x, y, _, w = self._to_film @ corners.T
        x, y = (one - offset * w for one, offset in zip((x, y), self._offset, strict=True))
        # Homogeneous coordinates: a corner behind the camera has w < 0, and the inequalities still hold.
        sides = (x < 0.0, x > w, y < 0.0, y > w, w < 0.0)
        return not any(bool(np.all(side)) for side in sides)


def _matrix(transform: Any) -> Any:
    return np.array(transform.matrix, dtype=np.float64).reshape(4, 4)

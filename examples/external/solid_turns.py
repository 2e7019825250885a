"""Random orientations, and the angles between orientations and directions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Host, from_numpy, to_numpy

__all__ = ["direction_at_angle", "host", "matrix_of", "parameters_like", "random_rows", "turn_between"]

Random = np.random.Generator


def random_rows(rng: Random) -> Host:
    """Return the first two rows of a uniformly distributed rotation matrix, as a free ``Rotate`` takes them."""
    first = _unit(rng.standard_normal(3))
    second = rng.standard_normal(3)
    return np.stack([first, _unit(second - (second @ first) * first)])


def turn_between(rows: Host, other: Host) -> float:
    """Return the angle in degrees of the rotation between two orientations, given by two rows each."""
    trace = float(np.sum(matrix_of(rows) * matrix_of(other)))
    return float(np.degrees(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))))


def direction_at_angle(direction: Host, degrees: float, rng: Random) -> Host:
    """Return a random unit vector at an angle from a direction."""
    axis = _unit(direction)
    sideways = rng.standard_normal(3)
    sideways = _unit(sideways - (sideways @ axis) * axis)
    turned: Host = np.cos(np.radians(degrees)) * axis + np.sin(np.radians(degrees)) * sideways
    return turned


def parameters_like(params: Parameters, values: Mapping[str, Any]) -> Parameters:
    """Return parameters with other values, each an array like the array that it replaces."""
    return params | {
        name: from_numpy(np.asarray(value, dtype=np.float64), params[name]) for name, value in values.items()
    }


def host(value: Any) -> Host:
    """Return a parameter as a float64 array of NumPy."""
    return np.asarray(to_numpy(value), dtype=np.float64)


def matrix_of(rows: Host) -> Host:
    """Return the rotation matrix of two rows."""
    first = _unit(rows[0])
    second = _unit(rows[1] - (rows[1] @ first) * first)
    return np.stack([first, second, np.cross(first, second)])


def _unit(vector: Host) -> Host:
    unit: Host = vector / np.linalg.norm(vector)
    return unit

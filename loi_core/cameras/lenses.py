"""Camera models of COLMAP and OpenCV: their pinhole, and the distortion that it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias

import numpy as np

from loi_core.cameras.posed_image import FloatMatrix
from loi_core.errors import CameraError, OptionError
from loi_core.support.wording import shown

__all__ = ["COEFFICIENTS", "PARAMETERS", "Distortion", "check_distortion_option", "pinhole_matrix"]

Distortion: TypeAlias = Literal["refuse", "ignore"]

MAX_SIDE: Final = 2**31 - 1  # pixels

COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Distortion coefficients of OpenCV, in its order."""

PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", *COEFFICIENTS),
}
"""Parameters of the models that are a pinhole with OpenCV's distortion, by COLMAP's names and in its order."""


def check_distortion_option(distortion: object) -> None:
    """Raise OptionError unless `distortion` is "refuse" or "ignore"."""
    if distortion not in ("refuse", "ignore"):
        msg = f'`distortion` must be "refuse" or "ignore", got {shown(distortion)}'
        raise OptionError(msg)


def pinhole_matrix(
    where: str, lens: Mapping[str, float], height: int, width: int, distortion: Distortion
) -> FloatMatrix:
    """Return the camera matrix, shape (3, 3), of a lens with parameters of :data:`PARAMETERS`.

    Raises
    ------
    CameraError
        Beginning with `where`: if a number is not finite, a focal length or size is not positive, or the lens distorts
        and `distortion` is "refuse".
    """
    fx, fy = (lens["f"], lens["f"]) if "f" in lens else (lens["fx"], lens["fy"])
    cx, cy = lens["cx"], lens["cy"]
    if not np.all(np.isfinite(list(lens.values()))) or min(fx, fy) <= 0.0:
        msg = f"{where}: the parameters of the lens must be finite and its focal lengths more than 0, got {shown(lens)}"
        raise CameraError(msg)
    if not 0 < min(height, width) <= max(height, width) <= MAX_SIDE:
        msg = f"{where}: the size must be 1 to {MAX_SIDE} pixels, got {shown(width)} x {shown(height)}"
        raise CameraError(msg)
    shift = _corner_shift(lens, (fx, fy), (cx, cy), height, width)
    if distortion == "refuse" and shift != 0.0:
        msg = (
            f"{where}: the lens distorts, by {shift:.3g} pixels at a corner; undistort the images, as with `colmap "
            'image_undistorter`, or pass distortion="ignore"'
        )
        raise CameraError(msg)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _corner_shift(
    lens: Mapping[str, float], focal: tuple[float, float], centre: tuple[float, float], height: int, width: int
) -> float:
    """Return the largest shift of an image corner, in pixels, that OpenCV's distortion causes."""
    coefficients = [lens.get(name, 0.0) for name in COEFFICIENTS]
    if not any(coefficients):
        return 0.0
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    with np.errstate(all="ignore"):  # a shift that is not finite is refused, as every other
        x, y = ((corners - centre) / focal).T
        squared = x * x + y * y
        numerator = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
        radial = numerator / (1.0 + squared * (k4 + squared * (k5 + squared * k6)))
        dx = x * (radial - 1.0) + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
        dy = y * (radial - 1.0) + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
        return float(np.max(np.hypot(focal[0] * dx, focal[1] * dy)))

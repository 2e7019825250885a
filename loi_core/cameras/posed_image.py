"""A photograph with the camera that took it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from loi_core.errors import OptionError
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["FloatMatrix", "PosedImage"]

FloatMatrix: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]


@suggest_keywords
@dataclass(frozen=True, eq=False)
class PosedImage:
    """A photograph with the camera that took it.

    Attributes
    ----------
    path : Path
        The image file, which may not exist.
    height, width : int
        Size of the image in pixels.
    intrinsics : array, shape (3, 3), float64
        Camera matrix in pixels, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``; (0, 0) is the image's top left corner.
    world_to_camera : array, shape (4, 4), float64
        Rotation and translation into the camera's axes, which are OpenCV's: x to the right, y down, z forward.
    """

    path: Path
    height: int
    width: int
    intrinsics: FloatMatrix
    world_to_camera: FloatMatrix

    def resized(self, height: int, width: int) -> PosedImage:
        """Return the same photograph with the intrinsics of another size in pixels.

        Raises
        ------
        OptionError
            If a size is not a whole number more than 0.
        """
        for name, value in (("height", height), ("width", width)):
            if (whole_number(value) or 0) < 1:
                msg = f"`{name}` must be a whole number more than 0, got {shown(value)}"
                raise OptionError(msg)
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return PosedImage(self.path, height, width, scale @ self.intrinsics, self.world_to_camera)

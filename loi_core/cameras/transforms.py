"""Cameras from `transforms.json`, which NeRF's Blender scenes, instant-ngp and nerfstudio share."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from loi_core.cameras.lenses import COEFFICIENTS, PARAMETERS, Distortion, pinhole_matrix
from loi_core.cameras.posed_image import FloatMatrix, PosedImage
from loi_core.errors import CameraError
from loi_core.io.files import read_bytes
from loi_core.io.images import read_image
from loi_core.support.values import real_number, whole_number
from loi_core.support.wording import described, shown

__all__ = ["read_transforms"]

MAX_BYTES: Final = 2**28
MAX_ROTATION_ERROR: Final = 1e-3  # of an element of R R^T
OPENCV_FROM_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""From axes with y up and z backward to axes with y down and z forward."""


def read_transforms(path: Path, images: Path | None, distortion: Distortion) -> Iterator[tuple[str, PosedImage]]:
    """Yield the names and images of a file, in its order.

    Raises
    ------
    CameraError
        If the file is missing or damaged, or a frame has a camera that is no pinhole.
    ImageFileError
        If the file has no image size, and its first image cannot be read.
    """
    try:
        document = json.loads(read_bytes(path, MAX_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        msg = f"{path}: cannot be read as transforms: {described(error)}"
        raise CameraError(msg) from error
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        msg = f"{path}: must be an object with a list `frames` of objects"
        raise CameraError(msg)
    folder = path.parent if images is None else images
    size: tuple[int, int] | None = None
    for number, frame in enumerate(frames):
        where = f"{path}: frames[{number}]"
        name = frame.get("file_path")
        if not isinstance(name, str) or not name:
            msg = f"{where}: `file_path` must be the name of an image, got {shown(name)}"
            raise CameraError(msg)
        name = str(PurePosixPath(name.replace("\\", "/")))
        file = folder / (name if PurePosixPath(name).suffix else f"{name}.png")  # as NeRF's Blender scenes leave it out
        settings = {**document, **frame}
        if "w" not in settings or "h" not in settings:  # all images have one size then
            size = size or read_image(file).shape[:2]
            settings |= {"h": size[0], "w": size[1]}
        height, width = (_whole(where, settings, key) for key in ("h", "w"))
        matrix = pinhole_matrix(where, _lens(where, settings, height, width), height, width, distortion)
        yield name, PosedImage(file, height, width, matrix, _world_to_camera(where, frame.get("transform_matrix")))


def _lens(where: str, settings: Mapping[str, Any], height: int, width: int) -> dict[str, float]:
    model = settings.get("camera_model", "OPENCV")
    if model not in (*PARAMETERS, "PERSPECTIVE") or settings.get("is_fisheye"):
        msg = f"{where}: the camera model {shown(model)} is no pinhole; undistort the images first"
        raise CameraError(msg)
    lens = {name: _number(where, settings, name, 0.0) for name in COEFFICIENTS}
    lens |= {"cx": _number(where, settings, "cx", 0.5 * width), "cy": _number(where, settings, "cy", 0.5 * height)}
    x = _focal(where, settings, "x", width)
    y = _focal(where, settings, "y", height)
    if x is None and y is None:
        msg = f"{where}: `fl_x` or `camera_angle_x` is missing"
        raise CameraError(msg)
    return {**lens, "fx": x or y or 0.0, "fy": y or x or 0.0}  # pixels are square unless both are given


def _focal(where: str, settings: Mapping[str, Any], axis: str, length: int) -> float | None:
    """Return the focal length in pixels, or else from the angle in radians across the image; None without both."""
    if f"fl_{axis}" in settings:
        return _number(where, settings, f"fl_{axis}", 0.0)
    if f"camera_angle_{axis}" not in settings:
        return None
    angle = _number(where, settings, f"camera_angle_{axis}", 0.0)
    if not 0.0 < angle < math.pi:
        msg = f"{where}: `camera_angle_{axis}` must be between 0 and pi, got {angle:g}"
        raise CameraError(msg)
    return 0.5 * length / math.tan(0.5 * angle)


def _number(where: str, settings: Mapping[str, Any], key: str, default: float) -> float:
    number = real_number(settings.get(key, default))
    if not math.isfinite(number):
        msg = f"{where}: `{key}` must be a finite number, got {shown(settings[key])}"
        raise CameraError(msg)
    return number


def _whole(where: str, settings: Mapping[str, Any], key: str) -> int:
    number = _number(where, settings, key, 0.0)
    whole = whole_number(int(number)) if number == int(number) else None
    if whole is None:
        msg = f"{where}: `{key}` must be a whole number, got {number:g}"
        raise CameraError(msg)
    return whole


def _world_to_camera(where: str, transform: Any) -> FloatMatrix:
    """Invert a camera-to-world matrix in OpenGL's axes; the scale of a camera in Blender has no effect."""
    try:
        matrix = np.array(transform, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.all(np.isfinite(matrix)):
        msg = f"{where}: `transform_matrix` must be 4 x 4 finite numbers, got {shown(transform)}"
        raise CameraError(msg)
    lengths = np.array([math.hypot(*column) for column in matrix[:3, :3].T])
    rotation = matrix[:3, :3] / np.where(lengths > 0.0, lengths, 1.0)
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > MAX_ROTATION_ERROR or np.linalg.det(rotation) < 0.0:
        msg = f"{where}: `transform_matrix` must turn, move and scale only, got {shown(transform)}"
        raise CameraError(msg)
    inverse = np.eye(4)
    with np.errstate(over="ignore"):
        inverse[:3, :3], inverse[:3, 3] = rotation.T, -rotation.T @ matrix[:3, 3]
    if not np.all(np.isfinite(inverse)):
        msg = f"{where}: `transform_matrix` moves too far, got {shown(transform)}"
        raise CameraError(msg)
    result: FloatMatrix = OPENCV_FROM_OPENGL @ inverse
    return result

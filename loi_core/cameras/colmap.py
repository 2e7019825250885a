"""Cameras from COLMAP's models, text and binary.

The formats are read here rather than by `pycolmap` 4.2, which loops forever on a truncated file, cuts names at their
first space, needs the scene's points, and takes 134 MB.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np

from loi_core.cameras.lenses import PARAMETERS, Distortion, pinhole_matrix
from loi_core.cameras.posed_image import FloatMatrix, PosedImage
from loi_core.errors import CameraError
from loi_core.io.files import open_regular
from loi_core.support.wording import described, shown

__all__ = ["is_colmap_model", "read_colmap"]

MODEL_NAMES: Final = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")
"""COLMAP's camera models by their numbers in binary files; later ones are no pinholes."""

MAX_NAME_BYTES: Final = 4096
BYTES_PER_POINT: Final = 24  # two coordinates and the number of a point of the scene
MAX_PARENTS: Final = 3  # from `project/colmap/sparse/0` to `project`


class Pose(NamedTuple):
    """A registered image of a model: its name, its camera's number, a quaternion w, x, y, z, and a translation."""

    name: str
    camera: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


class Lens(NamedTuple):
    """A camera of a model, with the parameters that :data:`PARAMETERS` names."""

    width: int
    height: int
    parameters: dict[str, float]


def is_colmap_model(folder: Path) -> bool:
    """Return whether a folder has the files of a model."""
    return any((folder / f"images{suffix}").exists() for suffix in (".bin", ".txt"))


def read_colmap(folder: Path, images: Path | None, distortion: Distortion) -> Iterator[tuple[str, PosedImage]]:
    """Yield the names and images of a model, sorted by name.

    Raises
    ------
    CameraError
        If a file is missing, damaged, or has a camera that is no pinhole.
    """
    suffix = ".bin" if (folder / "images.bin").exists() else ".txt"
    cameras_path, images_path = folder / f"cameras{suffix}", folder / f"images{suffix}"
    try:
        with open_regular(cameras_path) as stream:
            lenses = dict((_text_cameras if suffix == ".txt" else _binary_cameras)(stream))
        with open_regular(images_path) as stream:
            poses = list((_text_poses if suffix == ".txt" else _binary_poses)(stream))
    except (OSError, ValueError, struct.error) as error:
        msg = f"{folder}: cannot be read as a model of COLMAP: {described(error)}"
        raise CameraError(msg) from error
    image_folder = _image_folder(folder) if images is None else images
    for pose in sorted(poses):
        where = f"{images_path}: {shown(pose.name)}"
        if pose.camera not in lenses:
            msg = f"{where}: camera {pose.camera} is not in {cameras_path.name}"
            raise CameraError(msg)
        width, height, parameters = lenses[pose.camera]
        matrix = pinhole_matrix(where, parameters, height, width, distortion)
        extrinsics = _world_to_camera(where, pose)
        yield pose.name, PosedImage(image_folder / pose.name, height, width, matrix, extrinsics)


def _image_folder(folder: Path) -> Path:
    """Return the folder `images` of the project, where COLMAP and nerfstudio put it."""
    candidates = [parent / "images" for parent in (folder, *folder.absolute().parents[:MAX_PARENTS])]
    return next((candidate for candidate in candidates if candidate.is_dir()), folder)


def _world_to_camera(where: str, pose: Pose) -> FloatMatrix:
    length = math.hypot(*pose.quaternion)
    if not (math.isfinite(length) and length > 0.0 and np.all(np.isfinite(pose.translation))):
        msg = f"{where}: the pose must be finite, with a quaternion that is not 0"
        raise CameraError(msg)
    w, x, y, z = np.array(pose.quaternion) / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    matrix[:3, 3] = pose.translation
    return matrix


def _lens(model: str, width: int, height: int, values: list[float]) -> Lens:
    if model not in PARAMETERS:
        msg = f"the camera model {shown(model)} is no pinhole; undistort the images with `colmap image_undistorter`"
        raise ValueError(msg)
    return Lens(width, height, dict(zip(PARAMETERS[model], values, strict=True)))


def _text_cameras(stream: BinaryIO) -> Iterator[tuple[int, Lens]]:
    for line in stream:
        words = line.decode().split()
        if words and not words[0].startswith("#"):
            number, model, width, height, *values = words
            yield int(number), _lens(model, int(width), int(height), list(map(float, values)))


def _text_poses(stream: BinaryIO) -> Iterator[Pose]:
    for line in stream:
        text = line.strip()
        if text and not text.startswith(b"#"):
            _, *numbers, camera, name = text.decode().split(maxsplit=9)
            values = tuple(map(float, numbers))
            if len(values) != 7:
                msg = f"an image must have a quaternion and a translation, got {shown(text.decode())}"
                raise ValueError(msg)
            yield Pose(name, int(camera), values[:4], values[4:])
            stream.readline()  # its points


def _binary_cameras(stream: BinaryIO) -> Iterator[tuple[int, Lens]]:
    (count,) = _unpacked(stream, "<Q")
    for _ in range(count):
        number, model, width, height = _unpacked(stream, "<IiQQ")
        name = MODEL_NAMES[model] if 0 <= model < len(MODEL_NAMES) else f"number {model}"
        values = _unpacked(stream, f"<{len(PARAMETERS[name])}d") if name in PARAMETERS else ()
        yield number, _lens(name, width, height, list(values))


def _binary_poses(stream: BinaryIO) -> Iterator[Pose]:
    size = os.fstat(stream.fileno()).st_size
    (count,) = _unpacked(stream, "<Q")
    for _ in range(count):
        _, *numbers, camera = _unpacked(stream, "<I7dI")
        start = stream.tell()
        name, terminator, _ = stream.read(MAX_NAME_BYTES).partition(b"\0")
        stream.seek(start + len(name) + 1)
        (points,) = _unpacked(stream, "<Q")
        if not terminator or stream.tell() + BYTES_PER_POINT * points > size:
            msg = "images.bin ends within an image"
            raise ValueError(msg)
        stream.seek(BYTES_PER_POINT * points, os.SEEK_CUR)
        yield Pose(name.decode(), camera, tuple(numbers[:4]), tuple(numbers[4:]))


def _unpacked(stream: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, stream.read(struct.calcsize(layout)))

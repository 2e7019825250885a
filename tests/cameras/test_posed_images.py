"""Photographs with their cameras: conventions of the formats, damage, and lenses that distort."""

from __future__ import annotations

import contextlib
import json
import shutil
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from loi_core import PosedImage, read_posed_images
from loi_core.errors import CameraError, ImageFileError, OptionError
from loi_core.io.images import write_png
from tests.environments import ROOT
from tests.helpers import Host
from tests.strategies import SEEDS

SPARSE: Final = ROOT / "tests" / "data" / "cameras" / "sparse"
"""A model that pycolmap 4.2.1 wrote, in text and binary: three cameras that look at the origin."""

POSITIONS: Final = {"front.png": (0.0, -1.0, -6.0), "side/left.png": (-5.0, -2.0, 1.0), "top.png": (0.5, -7.0, 0.3)}
EPSILON: Final = float(np.finfo(np.float64).eps)


def projected(view: PosedImage, points: Host) -> Host:
    """Return points, shape (n, 3), in pixels, shape (n, 2)."""
    homogeneous = view.intrinsics @ (view.world_to_camera[:3, :3] @ points.T + view.world_to_camera[:3, 3:])
    pixels: Host = (homogeneous[:2] / homogeneous[2]).T
    return pixels


def only(suffix: str, folder: Path) -> Path:
    """Copy the model's files of one format."""
    for path in SPARSE.glob(f"*{suffix}"):
        shutil.copy(path, folder)
    return folder


# COLMAP.


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_a_model_that_colmap_wrote_has_its_cameras(suffix: str, tmp_path: Path) -> None:
    views = read_posed_images(only(suffix, tmp_path))
    assert list(views) == sorted(POSITIONS)
    for name, view in views.items():
        rotation, translation = view.world_to_camera[:3, :3], view.world_to_camera[:3, 3]
        np.testing.assert_allclose(-rotation.T @ translation, POSITIONS[name], atol=64 * EPSILON)
        np.testing.assert_allclose(projected(view, np.zeros((1, 3)))[0], view.intrinsics[:2, 2], atol=1e-12)
        assert rotation[1, 1] > 0.0 or name == "top.png"  # y points down in the world, as in the images
        assert view.path == tmp_path / name
    assert (views["front.png"].width, views["front.png"].height) == (64, 48)
    assert views["front.png"].intrinsics.tolist() == [[70.0, 0.0, 30.0], [0.0, 72.0, 25.0], [0.0, 0.0, 1.0]]
    assert views["top.png"].intrinsics.tolist() == [[45.0, 0.0, 20.0], [0.0, 45.0, 15.0], [0.0, 0.0, 1.0]]


@given(SEEDS)
def test_text_and_binary_models_give_the_pose_of_their_quaternion(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    quaternion, translation = rng.normal(size=4), rng.normal(size=3)
    parameters = [30.0, 31.0, 16.0, 12.0]
    text, binary = (tmp_path_factory.mktemp("model") for _ in range(2))
    (text / "cameras.txt").write_text(f"# a comment\n7 PINHOLE 32 24 {' '.join(map(repr, parameters))}\n")
    numbers = " ".join(repr(float(value)) for value in (*quaternion, *translation))
    (text / "images.txt").write_text(f"# a comment\n3 {numbers} 7 a name.png\n\n")
    (binary / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 7, 1, 32, 24, *parameters))
    record = struct.pack("<QI7dI", 1, 3, *quaternion, *translation, 7) + b"a name.png\0"
    (binary / "images.bin").write_bytes(record + struct.pack("<Q2dq", 1, 5.0, 6.0, -1))
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    expected[:3, 3] = translation
    for folder in (text, binary):
        (view,) = read_posed_images(folder).values()
        np.testing.assert_allclose(view.world_to_camera, expected, atol=16 * EPSILON)
        assert view.path == folder / "a name.png"


def test_the_images_of_a_model_are_in_the_folder_of_its_project(tmp_path: Path) -> None:
    sparse, images = tmp_path / "colmap" / "sparse" / "0", tmp_path / "images"
    sparse.mkdir(parents=True)
    images.mkdir()
    assert read_posed_images(only(".bin", sparse))["top.png"].path == images / "top.png"
    assert read_posed_images(sparse, tmp_path / "other")["top.png"].path == tmp_path / "other" / "top.png"


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_binary_model_that_is_cut_anywhere_is_refused(name: str, tmp_path: Path) -> None:
    only(".bin", tmp_path)
    content = (SPARSE / name).read_bytes()
    for length in range(len(content)):
        (tmp_path / name).write_bytes(content[:length])
        with pytest.raises(CameraError) as caught:
            read_posed_images(tmp_path)
        assert "\n" not in str(caught.value)


@given(st.data())
def test_a_damaged_model_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    suffix = data.draw(st.sampled_from([".bin", ".txt"]))
    folder = only(suffix, tmp_path_factory.mktemp("damaged"))
    path = folder / f"{data.draw(st.sampled_from(['cameras', 'images']))}{suffix}"
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with contextlib.suppress(CameraError):
        assert all(np.all(np.isfinite(view.world_to_camera)) for view in read_posed_images(folder).values())


# transforms.json.


def write_transforms(folder: Path, document: Mapping[str, Any]) -> Path:
    path = folder / "transforms.json"
    path.write_text(json.dumps(document))
    return path


def random_pose(seed: int) -> Host:
    """Return a camera-to-world matrix."""
    matrix = np.eye(4)
    rng = np.random.default_rng(seed)
    matrix[:3, :3], matrix[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    return matrix


@given(SEEDS, st.sampled_from([1.0, 0.3, 7.0]))
def test_a_pixel_is_where_the_ray_of_nerf_through_it_is_projected(
    tmp_path_factory: pytest.TempPathFactory, seed: int, scale: float
) -> None:
    """NeRF's axes are OpenGL's; a camera in Blender may have a scale, which has no effect."""
    pose, rng = random_pose(seed), np.random.default_rng(seed)
    fx, fy, cx, cy = rng.uniform(20.0, 60.0, 4)
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": 64, "h": 48}
    scaled = pose @ np.diag([scale, scale, scale, 1.0])
    frame = {"file_path": "./images/a.jpg", "transform_matrix": scaled.tolist()}
    path = write_transforms(tmp_path_factory.mktemp("nerf"), {**lens, "frames": [frame]})
    (view,) = read_posed_images(path).values()
    pixels = rng.uniform(0.0, 48.0, (5, 2))
    rays = np.column_stack([(pixels[:, 0] - cx) / fx, -(pixels[:, 1] - cy) / fy, -np.ones(5)]) @ pose[:3, :3].T
    points = pose[:3, 3] + rng.uniform(1.0, 9.0, (5, 1)) * rays
    np.testing.assert_allclose(projected(view, points), pixels, atol=1e-10)
    assert view.path == path.parent / "images" / "a.jpg"


def test_a_scene_of_nerf_has_the_size_of_its_first_image_and_names_without_suffix(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    write_png(tmp_path / "train" / "r_0.png", np.zeros((6, 8, 3)))
    frames = [{"file_path": f"./train/r_{n}", "transform_matrix": random_pose(n).tolist()} for n in range(3)]
    path = write_transforms(tmp_path, {"camera_angle_x": np.pi / 2, "frames": frames})
    views = read_posed_images(path)
    assert list(views) == ["train/r_0", "train/r_1", "train/r_2"]
    for number, view in enumerate(views.values()):
        assert view.path == tmp_path / "train" / f"r_{number}.png"
        assert (view.height, view.width) == (6, 8)
        np.testing.assert_allclose(view.intrinsics, [[4, 0, 4], [0, 4, 3], [0, 0, 1]], atol=16 * EPSILON)
    (tmp_path / "train" / "r_0.png").unlink()
    with pytest.raises(ImageFileError, match="no such image file"):
        read_posed_images(path)


def test_a_frame_may_have_a_lens_of_its_own(tmp_path: Path) -> None:
    frames = [
        {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()},
        {"file_path": "b.png", "transform_matrix": np.eye(4).tolist(), "fl_x": 20.0, "w": 32},
    ]
    document = {"fl_x": 10.0, "fl_y": 12.0, "w": 16, "h": 16, "camera_model": "OPENCV", "frames": frames}
    first, second = read_posed_images(write_transforms(tmp_path, document)).values()
    assert first.intrinsics.tolist() == [[10.0, 0.0, 8.0], [0.0, 12.0, 8.0], [0.0, 0.0, 1.0]]
    assert second.intrinsics.tolist() == [[20.0, 0.0, 16.0], [0.0, 12.0, 8.0], [0.0, 0.0, 1.0]]


GOOD: Final[dict[str, Any]] = {"fl_x": 10.0, "w": 16, "h": 12}
FRAME: Final[dict[str, Any]] = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "must be an object with a list `frames`"),
        ({"frames": [3]}, "must be an object with a list `frames` of objects"),
        ({"frames": []}, "has no images"),
        ({**GOOD, "frames": [{"transform_matrix": 1}]}, r"frames\[0\]: `file_path` must be the name of an image"),
        ({**GOOD, "frames": [{"file_path": "a"}]}, r"`transform_matrix` must be 4 x 4 finite numbers, got None"),
        ({**GOOD, "frames": [FRAME, FRAME]}, "names the image 'a.png' twice"),
        ({**GOOD, "w": 0, "frames": [FRAME]}, "the size must be 1 to"),
        ({**GOOD, "w": "16", "frames": [FRAME]}, "`w` must be a finite number, got '16'"),
        ({**GOOD, "h": 1.5, "frames": [FRAME]}, "`h` must be a whole number, got 1.5"),
        ({"w": 16, "h": 12, "frames": [FRAME]}, "`fl_x` or `camera_angle_x` is missing"),
        ({"w": 16, "h": 12, "camera_angle_x": 4.0, "frames": [FRAME]}, "must be between 0 and pi, got 4"),
        ({**GOOD, "camera_model": "OPENCV_FISHEYE", "frames": [FRAME]}, "'OPENCV_FISHEYE' is no pinhole"),
        ({**GOOD, "frames": [{**FRAME, "transform_matrix": np.diag([1, 1, -1, 1]).tolist()}]}, "must turn, move and"),
        ({**GOOD, "k1": 0.1, "frames": [FRAME]}, "the lens distorts, by 1 pixels at a corner"),
    ],
)
def test_transforms_of_no_pinhole_are_refused(document: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=message) as caught:
        read_posed_images(write_transforms(tmp_path, document))
    assert "\n" not in str(caught.value)


def test_files_that_are_no_transforms_are_refused(tmp_path: Path) -> None:
    for content in (b"", b"{", b"\xff", b"[" * 100_000):
        (tmp_path / "transforms.json").write_bytes(content)
        with pytest.raises(CameraError, match="cannot be read as transforms"):
            read_posed_images(tmp_path / "transforms.json")
    for path in (tmp_path, tmp_path / "gone"):
        with pytest.raises(CameraError, match="must be a JSON file of transforms, or a folder with COLMAP's"):
            read_posed_images(path)
    with pytest.raises(CameraError, match="`path` must be a path, got 3"):
        read_posed_images(3)  # type: ignore[arg-type]


# Lenses.


@given(st.floats(-0.3, 0.3).filter(lambda k: abs(k) > 1e-6))
def test_the_error_states_the_distance_by_which_a_lens_moves_a_corner(k: float) -> None:
    from loi_core.cameras.lenses import pinhole_matrix

    lens = {"f": 40.0, "cx": 32.0, "cy": 24.0, "k1": k}  # the corners are at a distance of 40 pixels: a radius of 1
    with pytest.raises(CameraError, match=rf"by {40.0 * abs(k):.3g} pixels at a corner".replace("+", r"\+")):
        pinhole_matrix("a", lens, 48, 64, "refuse")
    ignored = pinhole_matrix("a", lens, 48, 64, "ignore")
    assert np.array_equal(ignored, pinhole_matrix("a", {**lens, "k1": 0.0}, 48, 64, "refuse"))


def test_another_treatment_of_distortion_is_refused() -> None:
    with pytest.raises(OptionError, match='`distortion` must be "refuse" or "ignore", got 3'):
        read_posed_images(SPARSE, distortion=3)  # type: ignore[arg-type]


@given(SEEDS, st.integers(1, 99), st.integers(1, 99))
def test_a_resized_photograph_has_its_points_at_the_same_fraction(seed: int, height: int, width: int) -> None:
    view = read_posed_images(SPARSE)["front.png"]
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (6, 3))
    resized = view.resized(height, width)
    fractions = projected(view, points) / (view.width, view.height)
    np.testing.assert_allclose(projected(resized, points) / (width, height), fractions, atol=64 * EPSILON)
    assert (resized.height, resized.width) == (height, width)


def test_a_photograph_is_resized_to_whole_numbers_of_pixels() -> None:
    with pytest.raises(OptionError, match="`width` must be a whole number more than 0, got 0"):
        read_posed_images(SPARSE)["front.png"].resized(4, 0)

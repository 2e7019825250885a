"""Image files are read as documented, written whole, and refused in one line if they are damaged."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from loi_core.errors import ImageFileError, LoiError
from loi_core.io.files import atomic_path, write_text
from loi_core.io.images import read_image, write_png

RGB = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def test_a_png_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", RGB / 255.0)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), RGB / 255.0)


def test_values_beyond_the_display_range_are_clipped_on_writing(tmp_path: Path) -> None:
    image = np.array([[[-1.0, 2.0, np.nan]]])
    write_png(tmp_path / "a.png", image)
    assert read_image(tmp_path / "a.png").tolist() == [[[0.0, 1.0, 0.0]]]


def test_grey_opacity_and_sixteen_bits_are_read(tmp_path: Path) -> None:
    Image.fromarray(RGB[..., 0]).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png"), np.repeat(RGB[..., :1] / 255.0, 3, axis=2))
    Image.fromarray(np.concatenate([RGB, RGB[..., :1]], axis=-1)).save(tmp_path / "rgba.png")
    assert read_image(tmp_path / "rgba.png").shape == (5, 7, 4)
    deep = RGB[..., 0].astype(np.uint16) * 257
    Image.fromarray(deep).save(tmp_path / "deep.png")
    np.testing.assert_allclose(read_image(tmp_path / "deep.png")[..., 0], RGB[..., 0] / 255.0)


def test_colours_of_sixteen_bits_are_refused_rather_than_cut_to_eight(tmp_path: Path) -> None:
    header = struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    (tmp_path / "deep.png").write_bytes(png(header, bytes(7)))
    with pytest.raises(ImageFileError, match="PNGs of 16 bits are read only in grey"):
        read_image(tmp_path / "deep.png")


def test_a_jpeg_is_rotated_by_its_exif_orientation(tmp_path: Path) -> None:
    picture = Image.fromarray(np.zeros((8, 16, 3), dtype=np.uint8))
    exif = picture.getexif()
    exif[0x0112] = 6
    picture.save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg").shape == (16, 8, 3)


def test_integers_of_unknown_scale_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "u8.npy", RGB)
    np.testing.assert_array_equal(read_image(tmp_path / "u8.npy"), RGB / 255.0)
    np.save(tmp_path / "i64.npy", RGB.astype(np.int64))
    with pytest.raises(ImageFileError, match="must be floating point, uint8, uint16 or bool"):
        read_image(tmp_path / "i64.npy")


def test_an_exr_without_colours_is_refused_with_its_channels(tmp_path: Path) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"depth": np.zeros((4, 4), dtype=np.float32)}) as file:
        file.write(str(tmp_path / "d.exr"))
    with pytest.raises(ImageFileError, match="it has depth"):
        read_image(tmp_path / "d.exr")


def test_a_jpeg_is_read_within_the_error_of_its_compression(tmp_path: Path) -> None:
    Image.fromarray(np.full((16, 16, 3), 100, dtype=np.uint8)).save(tmp_path / "a.jpg", quality=95)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), 100 / 255.0, atol=2 / 255)


def test_exr_and_npy_keep_their_values(tmp_path: Path) -> None:
    radiance = (RGB / 16.0).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": radiance}) as file:
        file.write(str(tmp_path / "a.exr"))
    with OpenEXR.File(header, {"Y": np.ascontiguousarray(radiance[..., 0])}) as file:
        file.write(str(tmp_path / "y.exr"))
    np.save(tmp_path / "a.npy", radiance)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), radiance)
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), radiance)
    np.testing.assert_array_equal(read_image(tmp_path / "y.exr")[..., 2], radiance[..., 0])


def png(header: bytes, data: bytes) -> bytes:
    """A PNG with this header chunk and these uncompressed rows."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    signature = b"\x89PNG\r\n\x1a\n"
    return signature + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def damaged(folder: Path) -> dict[str, bytes]:
    write_png(folder / "whole.png", RGB / 255.0)
    np.save(folder / "whole.npy", np.zeros((4, 4, 3)))
    np.save(folder / "pickled.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(folder / "text.npy", np.array([["a", "b"]]))
    np.save(folder / "deep.npy", np.zeros((2, 2, 2, 2)))
    np.save(folder / "two.npy", np.zeros((2, 2, 2)))
    return {
        "cut.png": (folder / "whole.png").read_bytes()[:60],
        "cut.npy": (folder / "whole.npy").read_bytes()[:150],
        "pickled.npy": (folder / "pickled.npy").read_bytes(),
        "text.npy": (folder / "text.npy").read_bytes(),
        "deep.npy": (folder / "deep.npy").read_bytes(),
        "two.npy": (folder / "two.npy").read_bytes(),
        "empty.png": b"",
        "renamed.jpg": b"GIF89a",
        "noise.exr": b"\x76\x2f\x31\x01" + bytes(40),
        "bomb.png": png(struct.pack(">IIBBBBB", 30000, 30000, 8, 2, 0, 0, 0), bytes(9)),
    }


DAMAGED = (
    *("cut.png", "cut.npy", "pickled.npy", "text.npy", "deep.npy", "two.npy"),
    *("empty.png", "renamed.jpg", "noise.exr", "bomb.png"),
)


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused_by_name(name: str, tmp_path: Path) -> None:
    content = damaged(tmp_path)[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ImageFileError, match=name) as caught:
        read_image(tmp_path / name)
    assert isinstance(caught.value, OSError)
    assert isinstance(caught.value, LoiError)
    assert "\n" not in str(caught.value)


def test_missing_files_and_other_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageFileError, match="no such image file"):
        read_image(tmp_path / "none.png")
    with pytest.raises(ImageFileError, match=r"images must end in \.png, \.jpg, \.jpeg, \.exr, \.npy"):
        read_image(tmp_path / "a.gif")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(ImageFileError):
        read_image(tmp_path / "folder.png")


def test_files_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    file = tmp_path / "sub" / "a.txt"
    write_text(file, "old")

    def fail_half_way() -> None:
        with atomic_path(file) as temporary:
            temporary.write_text("half")
            message = "half way"
            raise RuntimeError(message)

    with pytest.raises(RuntimeError, match="half way"):
        fail_half_way()
    assert file.read_text() == "old"
    assert [path.name for path in file.parent.iterdir()] == ["a.txt"]


@pytest.mark.parametrize(
    ("width", "height", "says"),
    [
        (2**26, 1, "longer than the 65535"),
        (1, 65536, "longer than the 65535"),
        (8190, 8190, "can hold"),
        (8193, 8192, "more than the 67108864"),
    ],
)
def test_the_claimed_size_of_an_image_is_checked_before_allocation(
    width: int, height: int, says: str, tmp_path: Path
) -> None:
    (tmp_path / "a.png").write_bytes(png(struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0), b""))
    with pytest.raises(ImageFileError, match=says):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("mode", ["RGB", "L", "1", "P"])
def test_a_large_flat_image_is_read(mode: str, tmp_path: Path) -> None:
    Image.new(mode, (1500, 1500)).save(tmp_path / "a.png", optimize=True)
    assert read_image(tmp_path / "a.png").shape == (1500, 1500, 3)


def test_a_path_may_be_a_string(tmp_path: Path) -> None:
    np.save(tmp_path / "image.npy", np.zeros((2, 3, 3)))
    assert read_image(str(tmp_path / "image.npy")).shape == (2, 3, 3)

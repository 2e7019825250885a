"""Read and write images: PNG, JPEG, EXR and NPY, as floating-point arrays (H, W, 3)."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from loi_core.errors import ImageFileError
from loi_core.io.exr import read_exr
from loi_core.io.files import write_bytes
from loi_core.support.wording import described

__all__ = ["IMAGE_SUFFIXES", "FloatImage", "StoredImage", "png_bytes", "read_image", "read_stored", "write_png"]

FloatImage: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]

IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".exr", ".npy")
PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS: Final = 64 * 1024 * 1024  # a larger image is taken for damage or an attack
MAX_SIDE: Final = 65535  # the limit of JPEG; decoders take minutes for a line of millions of pixels
MAX_PIXELS_PER_BYTE: Final = 8300  # deflate expands a byte to at most 1032, each of up to eight pixels
MIN_CHECKED_PIXELS: Final = 2**20  # smaller images may be compressed further


@dataclass(frozen=True)
class StoredImage:
    """An image with the values of its file.

    Attributes
    ----------
    colours : array, shape (H, W, 3), float64
    opacity : array, shape (H, W), float64, optional
    for_display : bool
        Whether files of this kind hold display values: PNG, JPEG and integer NPY do.
    premultiplied : bool
        Whether colours are multiplied by the opacity, as in EXR.
    """

    colours: FloatImage
    opacity: FloatImage | None
    for_display: bool
    premultiplied: bool


def read_image(path: Path | str) -> FloatImage:
    """Read an image file as RGB.

    Parameters
    ----------
    path : path or str
        PNG and JPEG are scaled to [0, 1] and rotated by their EXIF orientation; nothing is linearised. PNGs of 16 bits
        must be grey. EXR and floating-point NPY keep their values; an NPY must have shape (H, W), (H, W, 1), (H, W, 3)
        or (H, W, 4), and is divided by the maximum of its dtype if it is uint8 or uint16. Opacity is a fourth channel,
        from NPY and PNG only; grey becomes three equal channels.

    Returns
    -------
    array, shape (H, W, 3) or (H, W, 4), float64

    Raises
    ------
    ImageFileError
        If the file is missing, damaged, of another kind, larger than 64 megapixels, longer than 65535 pixels, or too
        small for the pixels that it claims. Nothing in it is executed.
    """
    image, suffix = _read(Path(path))
    return image[..., :3] if suffix == ".exr" else image


def read_stored(path: Path | str) -> StoredImage:
    """Read an image file with the meaning of its values. Files and errors as in :func:`read_image`."""
    image, suffix = _read(Path(path))
    whole = suffix in (".png", ".jpg", ".jpeg") or (suffix == ".npy" and _holds_integers(Path(path)))
    opacity = image[..., 3] if image.shape[2] == 4 else None
    return StoredImage(image[..., :3], opacity, whole, suffix == ".exr")


def _holds_integers(path: Path) -> bool:
    return bool(_open_npy(path).dtype.kind == "u")


def _read(path: Path) -> tuple[FloatImage, str]:
    """Return colours, with opacity if there is one, shape (H, W, 3 or 4), and the suffix of the file."""
    suffix = path.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        msg = f"{path}: images must end in {', '.join(IMAGE_SUFFIXES)}"
        raise ImageFileError(msg)
    readers = {".npy": _read_npy, ".exr": _read_exr}
    try:
        if not path.is_file():
            msg = f"{path}: {'not a regular file' if path.exists() else 'no such image file'}"
            raise ImageFileError(msg)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # decoders warn of damage that they skip
            image = readers.get(suffix, _read_pillow)(path)
    except ImageFileError:
        raise
    except Exception as error:  # decoders raise any exception for a damaged file
        msg = f"{path}: not a readable {suffix[1:].upper()} image ({described(error)})"
        raise ImageFileError(msg) from error
    return _as_colour(path, image), suffix


def write_png(path: Path, image: np.ndarray[Any, Any]) -> None:
    """Write an image, shape (H, W, 3), values clipped to [0, 1], as an 8-bit PNG, whole or not at all."""
    write_bytes(path, png_bytes(image))


def png_bytes(image: np.ndarray[Any, Any]) -> bytes:
    """Return an image as the bytes of an 8-bit PNG."""
    from PIL import Image

    clipped = np.clip(np.nan_to_num(np.asarray(image, dtype=np.float64)), 0.0, 1.0)
    stream = io.BytesIO()
    Image.fromarray(np.rint(clipped * 255.0).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def _check_size(path: Path, height: int, width: int) -> None:
    if height * width > MAX_PIXELS:
        msg = f"{path}: {width} x {height} pixels are more than the {MAX_PIXELS} that are read"
        raise ImageFileError(msg)
    if max(height, width) > MAX_SIDE:
        msg = f"{path}: an image of {width} x {height} pixels is longer than the {MAX_SIDE} that are read"
        raise ImageFileError(msg)
    packed = height * width / max(1, path.stat().st_size)
    if height * width > MIN_CHECKED_PIXELS and packed > MAX_PIXELS_PER_BYTE:
        msg = f"{path}: {width} x {height} pixels are more than a file of {path.stat().st_size} bytes can hold"
        raise ImageFileError(msg)


def _read_pillow(path: Path) -> np.ndarray[Any, Any]:
    from PIL import Image, ImageOps

    with path.open("rb") as stream:
        head = stream.read(26)
    if head.startswith(PNG_SIGNATURE) and head[24:25] == b"\x10" and head[25:26] != b"\x00":
        msg = f"{path}: PNGs of 16 bits are read only in grey, Pillow would cut others to 8; use EXR or NPY"
        raise ImageFileError(msg)
    with Image.open(path, formats=["PNG", "JPEG"]) as stored:
        _check_size(path, stored.height, stored.width)
        picture = ImageOps.exif_transpose(stored)  # as viewers show it
        if picture.mode.startswith("I"):  # 16-bit grey
            return _scaled(picture, 65535.0)
        has_opacity = picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info
        return _scaled(picture.convert("RGBA" if has_opacity else "RGB"), 255.0)


def _read_npy(path: Path) -> np.ndarray[Any, Any]:
    values = _open_npy(path)
    shape, dtype = values.shape, values.dtype
    is_numeric = dtype.kind in "fb" or dtype in (np.uint8, np.uint16)
    if len(shape) not in (2, 3) or not is_numeric or shape[2:] not in ((), (1,), (3,), (4,)):
        msg = (
            f"{path}: an NPY image must be floating point, uint8, uint16 or bool, of shape (H, W) or "
            f"(H, W, 1, 3 or 4), got {dtype} {shape}"
        )
        raise ImageFileError(msg)
    _check_size(path, *shape[:2])
    return _scaled(values, 1.0 if dtype.kind in "fb" else float(np.iinfo(dtype).max))


def _open_npy(path: Path) -> np.ndarray[Any, Any]:
    """Map an NPY file into memory: a header that asks for more than the file holds is refused without allocating."""
    values: np.ndarray[Any, Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    return values


def _scaled(pixels: Any, maximum: float) -> np.ndarray[Any, Any]:
    """Return `pixels` as a new array, divided in place by `maximum`, since a second array may take gigabytes."""
    image = np.array(pixels, dtype=np.float64)
    image /= maximum
    return image


def _read_exr(path: Path) -> np.ndarray[Any, Any]:
    pixels = read_exr(path, MAX_PIXELS)
    return _scaled(pixels, 1.0)


def _as_colour(path: Path, image: np.ndarray[Any, Any]) -> FloatImage:
    if image.ndim == 2:
        image = image[..., None]
    if image.shape[2] == 1:
        image = np.repeat(image, 3, axis=2)
    if image.shape[2] not in (3, 4) or image.size == 0:
        msg = f"{path}: images must have 1, 3 or 4 channels and be not empty, got shape {image.shape}"
        raise ImageFileError(msg)
    return image

"""The image that a render is to match: a file as it is, made into what the renderer can be compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from loi_core.errors import ImageFileError, OptionError
from loi_core.io.images import FloatImage, StoredImage, read_stored
from loi_core.pixels.encoding import Encoding, check_encoding, decode_srgb, encode_srgb
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["BLACK", "Target", "prepare_target", "read_target"]

BLACK: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Target:
    """An image to match.

    Attributes
    ----------
    image : array, shape (H, W, 3), float64
        For the reference of an objective.
    weights : array, shape (H, W), float64, optional
        For its `weights`.
    encoding : {"linear", "sRGB"}, optional
        Of the image; None if nobody said.
    notes : tuple of str
        What was done to the file's values, a line each.
    """

    image: FloatImage
    weights: FloatImage | None = None
    encoding: Encoding | None = None
    notes: tuple[str, ...] = ()


def read_target(
    path: Path | str,
    *,
    to: Encoding | None = None,
    encoding: Encoding | None = None,
    alpha: str | Sequence[float] | FloatImage = BLACK,
    weights: Path | str | None = None,
) -> Target:
    """Read an image file as what a renderer is to be compared with.

    Parameters
    ----------
    path : path or str
        A file of ``loi_core.io.images.read_image``.
    to : {"linear", "sRGB"}, optional
        What the renderer makes: "linear" for radiance. Values stay as they are stored by default.
    encoding : {"linear", "sRGB"}, optional
        What the file holds. By default sRGB for PNG, JPEG and whole numbers, and linear for EXR and floating point.
    alpha : {"mask", "ignore"} or three numbers
        What becomes of a file's opacity: the image is composited over this colour, black by default; or the opacity
        becomes the weights; or nothing.
    weights : path or str, optional
        A second file, whose mean over the channels, times its opacity, says how much each pixel counts; it multiplies
        those of `alpha`.

    Returns
    -------
    Target

    Raises
    ------
    ImageFileError
        If a file cannot be read, or the two differ in size.
    OptionError
        If another argument is not allowed.

    Examples
    --------
    >>> target = read_target("photo.jpg", to="linear")                        # doctest: +SKIP
    >>> loss = LOILoss(target.image, weights=target.weights)                  # doctest: +SKIP
    """
    return prepare_target(Path(path), read_stored(path), to=to, encoding=encoding, alpha=alpha, weights=weights)


def prepare_target(
    path: Path,
    stored: StoredImage,
    *,
    to: str | None,
    encoding: str | None,
    alpha: str | Sequence[float] | FloatImage,
    weights: Path | str | None,
) -> Target:
    """What :func:`read_target` does, for a file that has been read."""
    wanted = None if to is None else check_encoding(to)
    given = None if encoding is None else check_encoding(encoding)
    over = _checked_alpha(alpha)
    opacity = None if stored.opacity is None else np.clip(stored.opacity, 0.0, 1.0)
    if opacity is not None and np.all(opacity == 1.0):
        opacity = None
    image, notes, premultiplied = stored.colours, [], stored.premultiplied and opacity is not None
    held: Encoding = given or ("sRGB" if stored.for_display else "linear")
    recoded = wanted is not None and wanted != held
    if opacity is not None and premultiplied and over != "ignore" and (recoded or over == "mask"):
        image, premultiplied = image / np.where(opacity > 0.0, opacity, 1.0)[..., None], False
    if recoded:
        image = decode_srgb(image) if wanted == "linear" else encode_srgb(image)
        why = "" if given else f", as {path.suffix[1:].upper()} files usually are"
        done = "decoded to linear light" if wanted == "linear" else "encoded as sRGB"
        notes.append(f"{path.name} is taken as {held}{why}, and {done}, which is what the renderer makes")
    counts: FloatImage | None = None
    if opacity is not None:
        if over == "mask":
            counts = opacity
            notes.append(f"the opacity of {path.name} says how much each pixel counts")
        elif over == "ignore":
            notes.append(f"the opacity of {path.name} is ignored")
        else:
            # What is premultiplied may hold light where nothing is opaque, such as a glow.
            front = image if premultiplied else opacity[..., None] * image
            image = front + (1.0 - opacity[..., None]) * np.asarray(over)
            notes.append(f"{path.name} is composited over {_named(over)} by its opacity")
    if opacity is None and over == "mask":
        notes.append(f"{path.name} has no opacity that could be a mask: all of its pixels count")
    if weights is not None:
        own = _read_weights(Path(weights), image.shape[:2])
        counts = own if counts is None else counts * own
    if counts is not None and not np.any(counts > 0.0):
        msg = f"{path}: every pixel has weight 0, so nothing would be compared"
        raise ImageFileError(msg)
    return Target(image, counts, wanted if wanted is not None else given, tuple(notes))


def _checked_alpha(alpha: object) -> str | tuple[float, ...]:
    if isinstance(alpha, str) and alpha in ("mask", "ignore"):
        return alpha
    if isinstance(alpha, Sequence | np.ndarray) and not isinstance(alpha, str):
        colour = tuple(map(real_number, alpha))
        if len(colour) == 3 and np.all(np.isfinite(colour)):
            return colour
    msg = f"`alpha` must be 'mask', 'ignore', or the three numbers of a colour, got {shown(alpha)}"
    raise OptionError(msg)


def _named(colour: str | tuple[float, ...]) -> str:
    return "black" if colour == BLACK else str([float(f"{one:g}") for one in colour if not isinstance(one, str)])


def _read_weights(path: Path, size: tuple[int, ...]) -> FloatImage:
    stored = read_stored(path)
    values: FloatImage = stored.colours.mean(axis=-1)
    if stored.opacity is not None:
        values = values if stored.premultiplied else values * stored.opacity
    if values.shape != size:
        msg = f"{path}: weights must be of the target's size, {size[0]} x {size[1]}, got {values.shape}"
        raise ImageFileError(msg)
    if not np.all(np.isfinite(values) & (values >= 0.0)):
        msg = f"{path}: weights must be finite and not negative"
        raise ImageFileError(msg)
    return values

"""Target images: files converted to the encoding of the renderer, with pixel weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from loi_core.errors import ImageFileError, OptionError
from loi_core.io.images import FloatImage, StoredImage, read_stored
from loi_core.pixels.encoding import Encoding, check_encoding, decode_srgb, encode_srgb
from loi_core.pixels.target import Target
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = ["BLACK", "Target", "prepare_target", "read_target"]

BLACK: Final = (0.0, 0.0, 0.0)


@suggest_keywords
def read_target(
    path: Path | str,
    *,
    to: Encoding | None = None,
    encoding: Encoding | None = None,
    alpha: str | Sequence[float] | FloatImage = BLACK,
    weights: Path | str | None = None,
) -> Target:
    """Read an image file as a target for a renderer.

    Parameters
    ----------
    path : path or str
        A file of ``loi_core.io.images.read_image``.
    to : {"linear", "sRGB"}, optional
        Encoding of the renderer's images: "linear" for radiance. Values are not converted by default.
    encoding : {"linear", "sRGB"}, optional
        Encoding of the file. By default sRGB for PNG, JPEG and integers, and linear for EXR and floating point.
    alpha : {"mask", "ignore"} or three numbers
        Treatment of the file's opacity: composite the image over this colour, black by default; use the opacity as
        weights; or ignore it.
    weights : path or str, optional
        A second file. The mean over its channels, times its opacity, gives the weight of each pixel; it multiplies the
        weights from `alpha`.

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
    >>> loss = loi_loss(render(params), target)                               # doctest: +SKIP
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
    """Return the target of a file that has been read; arguments and errors as in :func:`read_target`."""
    rendered = None if to is None else check_encoding(to)
    declared = None if encoding is None else check_encoding(encoding)
    backdrop = _checked_alpha(alpha)
    opacity = None if stored.opacity is None else np.clip(stored.opacity, 0.0, 1.0)
    if opacity is not None and np.all(opacity == 1.0):
        opacity = None
    image, notes, premultiplied = stored.colours, [], stored.premultiplied and opacity is not None
    source: Encoding = declared or ("sRGB" if stored.for_display else "linear")
    converts = rendered is not None and rendered != source
    if opacity is not None and premultiplied and backdrop != "ignore" and (converts or backdrop == "mask"):
        image, premultiplied = image / np.where(opacity > 0.0, opacity, 1.0)[..., None], False
    if converts:
        image = decode_srgb(image) if rendered == "linear" else encode_srgb(image)
        reason = "" if declared else f", as {path.suffix[1:].upper()} files usually are"
        conversion = "decoded to linear light" if rendered == "linear" else "encoded as sRGB"
        notes.append(f"{path.name} is taken as {source}{reason}, and {conversion} like the renderer's images")
    pixel_weights: FloatImage | None = None
    if opacity is not None:
        if backdrop == "mask":
            pixel_weights = opacity
            notes.append(f"the opacity of {path.name} gives the weight of each pixel")
        elif backdrop == "ignore":
            notes.append(f"the opacity of {path.name} is ignored")
        else:
            # Premultiplied pixels may hold light at opacity 0, such as a glow.
            front = image if premultiplied else opacity[..., None] * image
            image = front + (1.0 - opacity[..., None]) * np.asarray(backdrop)
            notes.append(f"{path.name} is composited over {_colour_name(backdrop)} by its opacity")
    if opacity is None and backdrop == "mask":
        notes.append(f"{path.name} has no opacity for a mask: all of its pixels count")
    if weights is not None:
        file_weights = _read_weights(Path(weights), image.shape[:2])
        pixel_weights = file_weights if pixel_weights is None else pixel_weights * file_weights
    if pixel_weights is not None and not np.any(pixel_weights > 0.0):
        msg = f"{path}: every pixel has weight 0, so nothing would be compared"
        raise ImageFileError(msg)
    return Target(image, pixel_weights, rendered if rendered is not None else declared, tuple(notes))


def _checked_alpha(alpha: object) -> str | tuple[float, ...]:
    if isinstance(alpha, str) and alpha in ("mask", "ignore"):
        return alpha
    if isinstance(alpha, Sequence | np.ndarray) and not isinstance(alpha, str):
        colour = tuple(map(real_number, alpha))
        if len(colour) == 3 and np.all(np.isfinite(colour)):
            return colour
    msg = f"`alpha` must be 'mask', 'ignore', or the three numbers of a colour, got {shown(alpha)}"
    raise OptionError(msg)


def _colour_name(colour: str | tuple[float, ...]) -> str:
    return "black" if colour == BLACK else str([float(f"{value:g}") for value in colour if not isinstance(value, str)])


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

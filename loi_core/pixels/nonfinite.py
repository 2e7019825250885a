"""Detection of NaN and infinite pixels, and a diagnosis of their pattern."""

from __future__ import annotations

import itertools
from typing import Final, Literal, get_args

import numpy as np

from loi_core.errors import NonFiniteImageError, OptionError
from loi_core.support.arrays import Array, Host, namespace, to_numpy
from loi_core.support.wording import shown

__all__ = ["NanPolicy", "check_nan_policy", "count_non_finite", "require_finite"]

NanPolicy = Literal["raise", "mask"]

SCATTERED: Final = "isolated pixels"


def check_nan_policy(policy: object) -> NanPolicy:
    """Return `policy` if it is valid."""
    for allowed in get_args(NanPolicy):
        if isinstance(policy, str) and policy == allowed:
            return allowed  # type: ignore[no-any-return]  # get_args is untyped; it yields the literals above
    msg = f"`nan_policy` must be one of {', '.join(map(repr, get_args(NanPolicy)))}, got {shown(policy)}"
    raise OptionError(msg)


def count_non_finite(array: Array) -> int:
    """Return the number of NaN and infinite values of `array`."""
    xp = namespace(array)
    return int(xp.sum(xp.astype(~xp.isfinite(array), xp.int32)))  # JAX has no int64 unless asked


def require_finite(name: str, image: Array, channel_axis: int | None) -> None:
    """Raise :class:`NonFiniteImageError` if `image`, shape (*batch, H, W, C), holds NaN or infinite values."""
    xp = namespace(image)
    if bool(xp.all(xp.isfinite(image))):
        return
    host = to_numpy(image)
    bad = ~np.isfinite(host)
    kinds = int(np.isnan(host).sum()), int(np.isposinf(host).sum()), int(np.isneginf(host).sum())
    first = tuple(int(index) for index in np.unravel_index(int(np.argmax(bad)), bad.shape))
    raise NonFiniteImageError(
        name, kinds, first, _axes(bad.ndim, channel_axis), int(bad.size), _suspicion(bad, kinds, channel_axis)
    )


def _axes(count: int, channel_axis: int | None) -> str:
    """Return the names of an image's axes, with one name for all batch axes: ``(*batch, y, x, c)``."""
    names = [*["*batch"] * (count - 2), "y", "x"]
    if channel_axis is not None:
        del names[0]
        names.insert(channel_axis % count, "c")
    return f"({', '.join(name for name, _ in itertools.groupby(names))})"


def _suspicion(bad: Host, kinds: tuple[int, int, int], channel_axis: int | None) -> str:
    """Return the pattern of the bad values and its usual cause."""
    pixels = bad[..., None] if channel_axis is None else np.moveaxis(bad, channel_axis, -1)
    batch, images = pixels.shape[:-3], pixels.reshape(-1, *pixels.shape[-3:])
    bad_images = np.flatnonzero(images.any(axis=(1, 2, 3)))
    prefix = ""
    if len(images) > 1 and len(bad_images) == 1:
        index = tuple(int(number) for number in np.unravel_index(bad_images[0], batch))
        prefix = f"only image {index[0] if len(index) == 1 else index} of the batch, "
        images = images[bad_images]
    pattern, cause = _pattern(images)
    _, positive, negative = kinds
    # If there are both, the infinity came first: its difference from another, or product with 0, is NaN.
    if positive:
        cause = f"an overflow: exp, a division by almost 0{'' if pattern == SCATTERED else ', float16 beyond 65504'}"
    elif negative:
        cause = "a logarithm of 0, or an overflow"
    return f"{prefix}{pattern}, which suggests {cause}"


def _pattern(bad: Host) -> tuple[str, str]:
    """Return the pattern of the bad values of images, shape (N, H, W, C), and the usual cause of NaN in it."""
    if bad.all():
        return "every value", "parameters that are not finite since the last step, or a division by a sum that is 0"
    channels = bad.all(axis=(0, 1, 2))
    if channels.any() and np.array_equal(bad.any(axis=(0, 1, 2)), channels):
        names = ", ".join(map(str, np.flatnonzero(channels)))
        return f"all of channel {names}", "a parameter of that channel, or the conversion to it"
    pixels = np.any(bad, axis=-1)
    for name, axis in (("rows", 2), ("columns", 1)):
        if pixels.shape[axis] > 1 and np.array_equal(pixels.any(axis=axis), pixels.all(axis=axis)):
            return f"whole {name}", "an unfinished render, or weights that are 0 along the border"
    padded = np.pad(pixels, ((0, 0), (1, 1), (1, 1)))
    neighbour_is_bad = padded[:, :-2, 1:-1] | padded[:, 2:, 1:-1] | padded[:, 1:-1, :-2] | padded[:, 1:-1, 2:]
    if 2 * np.count_nonzero(pixels & ~neighbour_is_bad) > np.count_nonzero(pixels):
        return SCATTERED, "0/0 in shading or sampling, or a normal of length 0"
    return "connected pixels", "one object whose parameters or texture are not finite"

"""Conversion between images, (*batch, H, W, C) with the channels on any axis, and flat stacks of planes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from loi_core.errors import ImageError, OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Layout", "check_channel_axis", "guessed_channel_axis"]

CHANNEL_COUNTS: Final = (1, 3, 4)
"""Usual numbers of channels: grey, RGB, and RGB with alpha."""


def check_channel_axis(channel_axis: object) -> int | None:
    """Return `channel_axis` if it is an int or None."""
    if channel_axis is None:
        return None
    axis = whole_number(channel_axis)
    if axis is None:
        msg = f"`channel_axis` must be an axis number, or None for images without channels, got {shown(channel_axis)}"
        raise OptionError(msg)
    return axis


def guessed_channel_axis(shape: tuple[int, ...]) -> int | str | None:
    """Return -1 or -3, the first of these axes with 1, 3 or 4 entries; None for two axes, "unknown" otherwise."""
    if len(shape) == 2:
        return None
    if len(shape) > 2 and shape[-1] in CHANNEL_COUNTS:
        return -1
    if len(shape) > 2 and shape[-3] in CHANNEL_COUNTS:
        return -3
    return "unknown"


def looks_channels_first(shape: tuple[int, ...]) -> bool:
    """Return whether an image of this shape has 1, 3 or 4 channels in front of at least 5 rows and 5 columns.

    Images with fewer rows or columns may have their channels last, such as (3, 20, 2): 3 rows of 20 pixels with two
    channels.
    """
    return guessed_channel_axis(shape) == -3 and min(shape[-2:]) > max(CHANNEL_COUNTS)


@dataclass(frozen=True)
class Layout:
    """Mapping between images of one shape and stacks of planes of shape (N, H, W).

    Attributes
    ----------
    shape : tuple of int
        Shape of the image.
    channel_axis : int or None
        Its channel axis, counted from the front; None for images without channels.
    name : str
        Name of the image in messages.
    """

    shape: tuple[int, ...]
    channel_axis: int | None
    name: str = field(default="image", compare=False)

    @classmethod
    def of(cls, name: str, shape: tuple[int, ...], channel_axis: int | None) -> Layout:
        """Return the layout of an image of this shape.

        Raises
        ------
        ImageError
            If the shape has too few axes, no such channel axis, or no pixels; or if the channel axis is -1 and the
            image looks channels first: 1, 3 or 4 entries on the third axis from the end, and 5 or more on the last
            two. An axis counted from the front, such as 2 for (H, W, C), is taken as it is.
        """
        last = channel_axis == -1
        min_axes = 2 if channel_axis is None else 3
        axes = "(*batch, H, W)" if channel_axis is None else "(*batch, H, W, C)"
        if len(shape) < min_axes:
            hint = "" if channel_axis is None else "; pass channel_axis=None for images without channels"
            msg = f"`{name}` must have at least {min_axes} axes, {axes}, got shape {tuple(shape)}{hint}"
            raise ImageError(msg)
        if channel_axis is not None:
            if not -len(shape) <= channel_axis < len(shape):
                msg = f"`channel_axis` is {channel_axis}, but `{name}` has shape {tuple(shape)}"
                raise ImageError(msg)
            channel_axis %= len(shape)
        if 0 in shape:
            msg = f"`{name}` must not be empty, got shape {tuple(shape)}"
            raise ImageError(msg)
        if last and looks_channels_first(shape):
            rows, columns, channels = shape[-3:]
            msg = (
                f"`{name}` has shape {tuple(shape)}, which looks channels first; pass channel_axis=-3, or "
                f"channel_axis={len(shape) - 1} if it has {rows} x {columns} pixels of {channels} channels"
            )
            raise ImageError(msg)
        return cls(tuple(shape), channel_axis, name)

    @property
    def planes_shape(self) -> tuple[int, ...]:
        """Shape with the channels in front of the rows: (*batch, C, H, W), or (*batch, H, W)."""
        return tuple(self.shape[axis] for axis in self._order)

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.planes_shape[-2]

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.planes_shape[-1]

    def to_planes(self, image: Array) -> Array:
        """Return `image` as planes, shape (N, H, W)."""
        xp = namespace(image)
        return xp.reshape(xp.permute_dims(image, self._order), (-1, self.height, self.width))

    def require_fit(self, reference: Layout) -> None:
        """Raise unless images of this layout can be compared with a reference of another.

        Raises
        ------
        ImageError
            If rows, columns or channels differ, or the batches do not fit; or if the channel axis counts from the
            front, where the images have more axes than the reference.
        """
        axes, extra = (self.channel_axis, reference.channel_axis), len(self.shape) - len(reference.shape)
        if extra and axes[0] is not None and axes[1] is not None and axes[0] - axes[1] != extra:
            msg = (
                f"`channel_axis` must count from the end (-3 for channels first) when batches differ: `{self.name}` "
                f"has shape {self.shape}, `{reference.name}` {reference.shape}"
            )
            raise ImageError(msg)
        shape, other = self.planes_shape, reference.planes_shape
        core = 2 if self.channel_axis is None else 3
        batch = (1,) * (len(shape) - len(other)) + other[:-core]
        fits = len(batch) == len(shape) - core and all(n in (1, m) for n, m in zip(batch, shape, strict=False))
        if shape[-core:] != other[-core:] or not fits:
            expected = f"`{reference.name}` of shape {reference.shape}"
            msg = f"`{self.name}` has shape {self.shape}, which does not fit {expected}"
            if core == 3 and {shape[-3], other[-3]} == {3, 4}:
                msg += (
                    "; composite the image of four channels over a background, as `read_target(path)` does: "
                    "rgb * opacity + background * (1 - opacity)"
                )
            raise ImageError(msg)

    def broadcast_planes(self, reference: Array, layout: Layout) -> Array:
        """Return `reference`, whose layout is `layout`, as planes of shape (N, H, W) that match this layout's.

        Batch axes of length 1, and batch axes that the reference lacks, are repeated. Errors as in :meth:`require_fit`.
        """
        self.require_fit(layout)
        xp = namespace(reference)
        stack = xp.broadcast_to(xp.permute_dims(reference, layout._order), self.planes_shape)
        return xp.reshape(stack, (-1, self.height, self.width))

    def to_image(self, planes: Array) -> Array:
        """Return planes, shape (N, H, W), in the shape of the image."""
        xp = namespace(planes)
        order = self._order
        inverse = tuple(order.index(axis) for axis in range(len(order)))
        return xp.permute_dims(xp.reshape(planes, self.planes_shape), inverse)

    @property
    def _order(self) -> tuple[int, ...]:
        axes = list(range(len(self.shape)))
        if self.channel_axis is None:
            return tuple(axes)
        axes.remove(self.channel_axis)
        return (*axes[:-2], self.channel_axis, *axes[-2:])

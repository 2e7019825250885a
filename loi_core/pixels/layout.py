"""Conversion between images, (*batch, H, W, C) with the channels on any axis, and flat stacks of planes."""

from __future__ import annotations

from dataclasses import dataclass

from loi_core.errors import ImageError, OptionError
from loi_core.support.arrays import Array, namespace
from loi_core.support.values import whole_number
from loi_core.support.wording import shown

__all__ = ["Layout", "check_channel_axis"]


def check_channel_axis(channel_axis: object) -> int | None:
    """Return `channel_axis` if it is an int or None."""
    if channel_axis is None:
        return None
    axis = whole_number(channel_axis)
    if axis is None:
        msg = f"`channel_axis` must be an axis number, or None for images without channels, got {shown(channel_axis)}"
        raise OptionError(msg)
    return axis


@dataclass(frozen=True)
class Layout:
    """Mapping between images of one shape and stacks of planes of shape (N, H, W).

    Attributes
    ----------
    shape : tuple of int
        Shape of the image.
    channel_axis : int or None
        Its channel axis, counted from the front; None for images without channels.
    """

    shape: tuple[int, ...]
    channel_axis: int | None

    @classmethod
    def of(cls, name: str, shape: tuple[int, ...], channel_axis: int | None) -> Layout:
        """Return the layout of an image of this shape.

        Raises
        ------
        ImageError
            If the shape has too few axes, no such channel axis, or no pixels.
        """
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
        return cls(tuple(shape), channel_axis)

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

    def require_fit(self, name: str, layout: Layout) -> None:
        """Raise unless images of this layout can be compared with a reference of `layout`.

        Raises
        ------
        ImageError
            If rows, columns or channels differ, or the batches do not fit.
        """
        shape, reference = self.planes_shape, layout.planes_shape
        core = 2 if self.channel_axis is None else 3
        batch = (1,) * (len(shape) - len(reference)) + reference[:-core]
        fits = len(batch) == len(shape) - core and all(n in (1, m) for n, m in zip(batch, shape, strict=False))
        if shape[-core:] != reference[-core:] or not fits:
            msg = f"`{name}` has shape {self.shape}, which does not fit the reference's shape {layout.shape}"
            raise ImageError(msg)

    def broadcast_planes(self, name: str, reference: Array, layout: Layout) -> Array:
        """Return `reference`, whose layout is `layout`, as planes of shape (N, H, W) that match this layout's.

        Batch axes of length 1, and batch axes that the reference lacks, are repeated. Errors as in :meth:`require_fit`.
        """
        self.require_fit(name, layout)
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

"""Textures: bilinear between texels, and between halved copies of the image where texels are smaller than pixels."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["Pyramid", "cube_face", "latlong"]


class Pyramid:
    """A texture and its halved copies (Williams 1983), to look up in.

    Parameters
    ----------
    texture : Tensor, shape (layers, h, w, c)
    wrap : (bool, bool)
        Whether it repeats across and downwards; where not, its border goes on.
    deepest : int, optional
        How often it is halved at most.
    """

    def __init__(self, texture: Tensor, wrap: tuple[bool, bool], deepest: int | None = None) -> None:
        self._wrap = wrap
        self._levels = [texture]
        while max(self._levels[-1].shape[1:3]) > 1 and (deepest is None or len(self._levels) <= deepest):
            self._levels.append(_halved(self._levels[-1]))

    def look_up(self, layer: Tensor, place: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Colours, shape (s, c).

        Parameters
        ----------
        layer : Tensor of int64, shape (s,)
        place : Tensor, shape (s, 2)
            Across and down, 0 to 1 over the texture.
        footprint : Tensor, shape (s,), optional
            Side of a pixel in units of `place`; it chooses the copies, and carries no gradient. The texture itself
            without it.
        """
        if footprint is None or len(self._levels) == 1:
            return self._bilinear(0, layer, place)
        height, width = self._levels[0].shape[1:3]
        size = footprint.detach() * max(height, width)
        level = torch.log2(size.clamp(min=1.0)).clamp(max=float(len(self._levels) - 1))
        coarse = level.floor().clamp(max=float(len(self._levels) - 2))
        share = level - coarse
        result = place.new_zeros((len(place), self._levels[0].shape[3]))
        for number in torch.unique(coarse).to(torch.int64).tolist():
            at = torch.nonzero(coarse == number)[:, 0]
            rows, places, part = layer[at], place.index_select(0, at), share[at, None]
            near = self._bilinear(number, rows, places)
            mixed = near
            if bool((part > 0.0).any()):
                mixed = (1.0 - part) * near + part * self._bilinear(number + 1, rows, places)
            result = result.index_copy(0, at, mixed)
        return result

    def _bilinear(self, level: int, layer: Tensor, place: Tensor) -> Tensor:
        texture = self._levels[level]
        _, height, width, channels = texture.shape
        flat = texture.reshape(-1, channels)
        x, y = place[:, 0] * width - 0.5, place[:, 1] * height - 0.5
        left, top = torch.floor(x.detach()), torch.floor(y.detach())
        right_share, low_share = (x - left)[:, None], (y - top)[:, None]
        columns = [_at(left + k, width, wrap=self._wrap[0]) for k in (0, 1)]
        rows = [(layer * height + _at(top + k, height, wrap=self._wrap[1])) * width for k in (0, 1)]
        upper, lower = (
            (1.0 - right_share) * flat.index_select(0, row + columns[0])
            + right_share * flat.index_select(0, row + columns[1])
            for row in rows
        )
        return (1.0 - low_share) * upper + low_share * lower


def _halved(texture: Tensor) -> Tensor:
    """Means of areas of 2 x 2 texels, or a little more where a side is odd, so that each texel counts as much."""
    return _halved_along(_halved_along(texture, 1), 2)


def _halved_along(texture: Tensor, axis: int) -> Tensor:
    size = texture.shape[axis]
    if size == 1:
        return texture
    half = size // 2
    first, second = (texture.narrow(axis, k, size - 1).unfold(axis, 1, 2)[..., 0] for k in (0, 1))
    if size % 2 == 0:
        return 0.5 * (first + second)
    # Of 2 m + 1 texels each of m takes 2 + 1 / m: two and a part, or one and parts of both of its neighbours.
    third = texture.narrow(axis, 2, size - 2).unfold(axis, 1, 2)[..., 0]
    row = torch.arange(half, dtype=texture.dtype, device=texture.device).reshape([-1] + [1] * (3 - axis))
    return ((half - row) * first + half * second + (row + 1.0) * third) / size


def _at(place: Tensor, size: int, *, wrap: bool) -> Tensor:
    place = torch.remainder(place, size) if wrap else place.clamp(0, size - 1)
    return place.to(torch.int64)


def cube_face(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Which face of a cube map a direction meets, and where.

    Parameters
    ----------
    direction : Tensor, shape (s, 3)
        Of any length but 0.

    Returns
    -------
    face : Tensor of int64, shape (s,)
        +x, -x, +y, -y, +z, -z, in the orientations of OpenGL.
    place : Tensor, shape (s, 2)
        Across and down, 0 to 1.
    """
    x, y, z = direction.unbind(dim=1)
    size = direction.detach().abs()
    axis = size.argmax(dim=1)
    along = direction.gather(1, axis[:, None])[:, 0]
    negative = along.detach() < 0.0
    face = 2 * axis + negative
    across = torch.where(axis == 0, torch.where(negative, z, -z), torch.where((axis == 2) & negative, -x, x))
    down = torch.where(axis == 1, torch.where(negative, -z, z), -y)
    length = along.abs()
    length = torch.where(length > 0.0, length, torch.ones_like(length))
    return face, 0.5 * torch.stack([across / length + 1.0, down / length + 1.0], dim=1)


def latlong(direction: Tensor) -> Tensor:
    """Where a direction lies on a map of longitude and latitude, shape (s, 2): across and down, 0 to 1.

    The middle of the map is -z, its left half is -x, and its top is +y.
    """
    x, y, z = direction.unbind(dim=1)
    level = torch.sqrt((x * x + z * z).clamp(min=1e-24))  # at a pole every longitude is the same
    return torch.stack([0.5 + torch.atan2(x, -z) / (2.0 * torch.pi), torch.atan2(level, y) / torch.pi], dim=1)

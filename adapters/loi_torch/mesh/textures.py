"""Textures: trilinear lookup in a mipmap, and texture coordinates of environment maps."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["MipPyramid", "cube_coordinates", "latlong_coordinates"]


class MipPyramid:
    """A texture, shape (layers, h, w, c), and its mipmap levels (Williams 1983).

    `wrap` is whether the texture repeats horizontally and vertically; if not, its border is extended.
    """

    def __init__(self, texture: Tensor, wrap: tuple[bool, bool]) -> None:
        self._wrap = wrap
        self._levels = [texture]
        while max(self._levels[-1].shape[1:3]) > 1:
            # Areas of 2 x 2 texels, slightly larger along odd sides, so that every texel has the same weight.
            self._levels.append(_halved_along(_halved_along(self._levels[-1], 1), 2))

    def sample(self, layer: Tensor, position: Tensor, footprint: Tensor | None = None) -> Tensor:
        """Return the colours, shape (s, c), at positions from the top left corner (0, 0) to (1, 1), shape (s, 2).

        The `footprint`, shape (s,), is the side of a pixel in units of `position`; it selects the levels and carries no
        gradient. Without it, only the texture itself is used.
        """
        if footprint is None or len(self._levels) == 1:
            return self._bilinear(0, layer, position)
        height, width = self._levels[0].shape[1:3]
        size = footprint.detach() * max(height, width)
        level = torch.log2(size.clamp(min=1.0)).clamp(max=float(len(self._levels) - 1))
        lower = level.floor().clamp(max=float(len(self._levels) - 2))
        fraction = level - lower
        result = position.new_zeros((len(position), self._levels[0].shape[3]))
        for number in torch.unique(lower).to(torch.int64).tolist():
            rows = torch.nonzero(lower == number)[:, 0]
            layers, positions, weight = layer[rows], position.index_select(0, rows), fraction[rows, None]
            colours = self._bilinear(number, layers, positions)
            if bool((weight > 0.0).any()):
                colours = (1.0 - weight) * colours + weight * self._bilinear(number + 1, layers, positions)
            result = result.index_copy(0, rows, colours)
        return result

    def _bilinear(self, level: int, layer: Tensor, position: Tensor) -> Tensor:
        texture = self._levels[level]
        _, height, width, channels = texture.shape
        texels = texture.reshape(-1, channels)
        x, y = position[:, 0] * width - 0.5, position[:, 1] * height - 0.5
        left, top = torch.floor(x.detach()), torch.floor(y.detach())
        right_weight, bottom_weight = (x - left)[:, None], (y - top)[:, None]
        columns = [_texel_index(left + k, width, wrap=self._wrap[0]) for k in (0, 1)]
        rows = [(layer * height + _texel_index(top + k, height, wrap=self._wrap[1])) * width for k in (0, 1)]
        upper, lower = (
            (1.0 - right_weight) * texels.index_select(0, row + columns[0])
            + right_weight * texels.index_select(0, row + columns[1])
            for row in rows
        )
        return (1.0 - bottom_weight) * upper + bottom_weight * lower


def _halved_along(texture: Tensor, axis: int) -> Tensor:
    size = texture.shape[axis]
    if size == 1:
        return texture
    half = size // 2
    first, second = (texture.narrow(axis, k, size - 1).unfold(axis, 1, 2)[..., 0] for k in (0, 1))
    if size % 2 == 0:
        return 0.5 * (first + second)
    # A side of 2 m + 1 texels becomes m texels of 2 + 1 / m each: one or two whole texels and fractions of neighbours.
    third = texture.narrow(axis, 2, size - 2).unfold(axis, 1, 2)[..., 0]
    row = torch.arange(half, dtype=texture.dtype, device=texture.device).reshape([-1] + [1] * (3 - axis))
    return ((half - row) * first + half * second + (row + 1.0) * third) / size


def _texel_index(position: Tensor, size: int, *, wrap: bool) -> Tensor:
    position = torch.remainder(position, size) if wrap else position.clamp(0, size - 1)
    return position.to(torch.int64)


def cube_coordinates(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Return the face of a cube map in each direction, shape (s,), and the position on it, shape (s, 2), 0 to 1.

    The faces are +x, -x, +y, -y, +z, -z in the orientations of OpenGL. Directions have any length but 0.
    """
    x, y, z = direction.unbind(dim=1)
    axis = direction.detach().abs().argmax(dim=1)
    major = direction.gather(1, axis[:, None])[:, 0]
    is_negative = major.detach() < 0.0
    face = 2 * axis + is_negative
    right = torch.where(axis == 0, torch.where(is_negative, z, -z), torch.where((axis == 2) & is_negative, -x, x))
    down = torch.where(axis == 1, torch.where(is_negative, -z, z), -y)
    length = major.abs()
    length = torch.where(length > 0.0, length, torch.ones_like(length))
    return face, 0.5 * torch.stack([right / length + 1.0, down / length + 1.0], dim=1)


def latlong_coordinates(direction: Tensor) -> Tensor:
    """Return the position of each direction on a map of longitude and latitude, shape (s, 2), 0 to 1.

    The middle of the map is -z, its left half is -x, and its top is +y.
    """
    x, y, z = direction.unbind(dim=1)
    horizontal = torch.sqrt((x * x + z * z).clamp(min=1e-24))  # the longitude of a pole is arbitrary
    longitude, colatitude = torch.atan2(x, -z), torch.atan2(horizontal, y)
    return torch.stack([0.5 + longitude / (2.0 * torch.pi), colatitude / torch.pi], dim=1)

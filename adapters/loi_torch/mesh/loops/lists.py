"""Which triangles may show in a pixel, and which of them is nearest at a point of it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.loops.triangles import Triangles
from loi_torch.mesh.tolerances import MARGIN

__all__ = ["Lists", "lists_of", "nearest_at"]


class Lists(NamedTuple):
    """The triangles that may show in each pixel that has a list."""

    slot: Any  # (H * W,) int32: the pixel's list, or -1
    first: Any  # (k + 1,) int64
    triangle: Any  # int32; of each list those that may be nearest come first
    pixel: Any  # of each list, int32
    width: int  # of the image


@compiled_as_written
def _touches(e: Any, x: float, y: float) -> bool:
    """Whether a triangle may touch the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    reached = True
    for j in range(3):
        reached &= e[j, 0] * x + e[j, 1] * y + e[j, 2] + half * (abs(e[j, 0]) + abs(e[j, 1])) >= 0.0
    return reached


@compiled_as_written
def _most_near(plane: Any, x: float, y: float) -> float:
    """At least the most nearness of a triangle's plane within the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    most = plane[0] * x + plane[1] * y + plane[2] + half * (abs(plane[0]) + abs(plane[1]))
    return float(most + 1e-12 * abs(most))


@compiled_as_written
def lists_of(triangles: Triangles, wanted: Any, height: int, width: int) -> Lists:
    """Lists of the triangles in the wanted pixels."""
    slot = np.full(height * width, -1, np.int32)
    pixel_of = np.empty(height * width, np.int32)
    # Of each row, how many wanted pixels lie before each column: boxes without any are skipped.
    before = np.zeros((height, width + 1), np.int32)
    count = 0
    for pixel in range(height * width):
        row, column = pixel // width, pixel % width
        before[row, column + 1] = before[row, column]
        if wanted[pixel]:
            slot[pixel] = count
            pixel_of[count] = pixel
            count += 1
            before[row, column + 1] += 1
    first = np.zeros(count + 1, np.int64)
    listed = np.empty(0, np.int32)
    for filling in range(2):
        if filling:
            for k in range(count):
                first[k + 1] += first[k]
            listed = np.empty(first[count], np.int32)
            place = first[:-1].copy()
        for k in range(len(triangles.drawn)):
            if not triangles.drawn[k]:
                continue
            left, right = triangles.box[k, 0], triangles.box[k, 1]
            for row in range(triangles.box[k, 2], triangles.box[k, 3] + 1):
                if before[row, right + 1] == before[row, left]:
                    continue
                for column in range(left, right + 1):
                    one = slot[row * width + column]
                    if one >= 0 and _touches(triangles.edges[k], column + 0.5, row + 0.5):
                        if filling:
                            listed[place[one]] = k
                            place[one] += 1
                        else:
                            first[one + 1] += 1
    for k in range(count):
        own = listed[first[k] : first[k + 1]]
        bound = np.empty(len(own))
        pixel = pixel_of[k]
        for j in range(len(own)):
            bound[j] = -_most_near(triangles.nearness[own[j]], pixel % width + 0.5, pixel // width + 0.5)
        kept, order = own.copy(), np.argsort(bound, kind="mergesort")
        for j in range(len(own)):
            own[j] = kept[order[j]]  # which is a part of `listed`
    return Lists(slot, first, listed, pixel_of, width)


@compiled_as_written
def nearest_at(triangles: Triangles, lists: Lists, one: int, x: float, y: float) -> int:
    """The triangle that is nearest at a point of the pixel with list `one`, or -1."""
    found, nearest = -1, -math.inf
    middle_x, middle_y = lists.pixel[one] % lists.width + 0.5, lists.pixel[one] // lists.width + 0.5
    for place in range(lists.first[one], lists.first[one + 1]):
        k = lists.triangle[place]
        e, n = triangles.edges[k], triangles.nearness[k]
        if _most_near(n, middle_x, middle_y) < nearest:
            break  # as are all that follow
        if (
            e[0, 0] * x + e[0, 1] * y + e[0, 2] >= 0.0
            and e[1, 0] * x + e[1, 1] * y + e[1, 2] >= 0.0
            and e[2, 0] * x + e[2, 1] * y + e[2, 2] >= 0.0
        ):
            near = n[0] * x + n[1] * y + n[2]
            if near <= triangles.most and (near > nearest or (near == nearest and k < found)):
                found, nearest = k, near
    return found

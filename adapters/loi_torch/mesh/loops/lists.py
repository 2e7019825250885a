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
def _touches(edges: Any, k: int, x: float, y: float) -> bool:
    """Whether triangle `k` may touch the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    reached = True
    for j in range(3):
        a, b = edges[k, j, 0], edges[k, j, 1]
        reached &= a * x + b * y + edges[k, j, 2] + half * (abs(a) + abs(b)) >= 0.0
    return reached


@compiled_as_written
def _most_near(planes: Any, k: int, x: float, y: float) -> float:
    """At least the most nearness of the plane of triangle `k` within the pixel with its centre at (x, y)."""
    half = 0.5 + MARGIN
    a, b = planes[k, 0], planes[k, 1]
    most = a * x + b * y + planes[k, 2] + half * (abs(a) + abs(b))
    return float(most + 1e-12 * abs(most))


@compiled_as_written
def lists_of(triangles: Triangles, wanted: Any, height: int, width: int) -> Lists:
    """Lists of the triangles in the wanted pixels."""
    drawn, edges, box = triangles.drawn, triangles.edges, triangles.box
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
        for k in range(len(drawn)):
            if not drawn[k]:
                continue
            left, right = box[k, 0], box[k, 1]
            for row in range(box[k, 2], box[k, 3] + 1):
                if before[row, right + 1] == before[row, left]:
                    continue
                for column in range(left, right + 1):
                    one = slot[row * width + column]
                    if one >= 0 and _touches(edges, k, column + 0.5, row + 0.5):
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
            bound[j] = -_most_near(triangles.nearness, own[j], pixel % width + 0.5, pixel // width + 0.5)
        kept, order = own.copy(), np.argsort(bound, kind="mergesort")
        for j in range(len(own)):
            own[j] = kept[order[j]]  # which is a part of `listed`
    return Lists(slot, first, listed, pixel_of, width)


@compiled_as_written
def nearest_at(triangles: Triangles, lists: Lists, one: int, x: float, y: float) -> int:
    """The triangle that is nearest at a point of the pixel with list `one`, or -1."""
    edges, planes = triangles.edges, triangles.nearness
    found, nearest = -1, -math.inf
    middle_x, middle_y = lists.pixel[one] % lists.width + 0.5, lists.pixel[one] // lists.width + 0.5
    for place in range(lists.first[one], lists.first[one + 1]):
        k = lists.triangle[place]
        if _most_near(planes, k, middle_x, middle_y) < nearest:
            break  # as are all that follow
        if (
            edges[k, 0, 0] * x + edges[k, 0, 1] * y + edges[k, 0, 2] >= 0.0
            and edges[k, 1, 0] * x + edges[k, 1, 1] * y + edges[k, 1, 2] >= 0.0
            and edges[k, 2, 0] * x + edges[k, 2, 1] * y + edges[k, 2, 2] >= 0.0
        ):
            near = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
            if near <= triangles.most and (near > nearest or (near == nearest and k < found)):
                found, nearest = k, near
    return found

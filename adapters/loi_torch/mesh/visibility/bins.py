"""Triangles binned to pixels, and visibility queries within a bin."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from loi_core.method.compiled.compiling import compiled_as_written
from loi_torch.mesh.visibility.edge_functions import BIN_MARGIN_PX, Triangles, covers, depth_at

__all__ = ["QUERY_OFFSET_PX", "Bins", "bin_triangles", "nearest_triangle"]

QUERY_OFFSET_PX: Final = 1e-6  # distance from an edge of the two visibility queries beside it


class Bins(NamedTuple):
    """The triangles that may be visible in each selected pixel."""

    triangles: Triangles
    bin_of_pixel: Any  # (H * W,) int32, -1 for pixels without a bin
    first: Any  # (k + 1,) int64: offsets into `members`
    members: Any  # int32; within a bin in order of decreasing largest reversed depth
    pixel: Any  # (k,) int32
    width: int  # of the image


@compiled_as_written
def _overlaps_pixel(edges: Any, k: int, x: float, y: float) -> bool:
    """Return whether triangle `k` may overlap the pixel with centre (x, y)."""
    half = 0.5 + BIN_MARGIN_PX
    overlaps = True
    for j in range(3):
        a, b = edges[k, j, 0], edges[k, j, 1]
        overlaps &= a * x + b * y + edges[k, j, 2] + half * (abs(a) + abs(b)) >= 0.0
    return overlaps


@compiled_as_written
def _depth_bound(planes: Any, k: int, x: float, y: float) -> float:
    """Return an upper bound of the reversed depth of triangle `k` within the pixel with centre (x, y)."""
    half = 0.5 + BIN_MARGIN_PX
    a, b = planes[k, 0], planes[k, 1]
    bound = a * x + b * y + planes[k, 2] + half * (abs(a) + abs(b))
    return float(bound + 1e-12 * abs(bound))


@compiled_as_written
def bin_triangles(triangles: Triangles, selected: Any, height: int, width: int) -> Bins:
    """Bin triangles to the `selected` pixels, shape (H * W,)."""
    in_frame, edges, box = triangles.in_frame, triangles.edges, triangles.box
    bin_of_pixel = np.full(height * width, -1, np.int32)
    pixel_of_bin = np.empty(height * width, np.int32)
    # Running number of selected pixels along each row: bounding boxes without any are skipped.
    running = np.zeros((height, width + 1), np.int32)
    count = 0
    for pixel in range(height * width):
        row, column = pixel // width, pixel % width
        running[row, column + 1] = running[row, column]
        if selected[pixel]:
            bin_of_pixel[pixel] = count
            pixel_of_bin[count] = pixel
            count += 1
            running[row, column + 1] += 1
    first = np.zeros(count + 1, np.int64)
    members = np.empty(0, np.int32)
    for filling in range(2):  # the first pass counts
        if filling:
            for k in range(count):
                first[k + 1] += first[k]
            members = np.empty(first[count], np.int32)
            cursor = first[:-1].copy()
        for k in range(len(in_frame)):
            if not in_frame[k]:
                continue
            left, right = box[k, 0], box[k, 1]
            for row in range(box[k, 2], box[k, 3] + 1):
                if running[row, right + 1] == running[row, left]:
                    continue
                for column in range(left, right + 1):
                    bin_index = bin_of_pixel[row * width + column]
                    if bin_index >= 0 and _overlaps_pixel(edges, k, column + 0.5, row + 0.5):
                        if filling:
                            members[cursor[bin_index]] = k
                            cursor[bin_index] += 1
                        else:
                            first[bin_index + 1] += 1
    for k in range(count):
        in_bin = members[first[k] : first[k + 1]]  # a view, sorted in place
        bound = np.empty(len(in_bin))
        pixel = pixel_of_bin[k]
        for j in range(len(in_bin)):
            bound[j] = -_depth_bound(triangles.planes, in_bin[j], pixel % width + 0.5, pixel // width + 0.5)
        unsorted, order = in_bin.copy(), np.argsort(bound, kind="mergesort")
        for j in range(len(in_bin)):
            in_bin[j] = unsorted[order[j]]
    return Bins(triangles, bin_of_pixel, first, members, pixel_of_bin, width)


@compiled_as_written
def nearest_triangle(bins: Bins, bin_index: int, x: float, y: float) -> int:
    """Return the nearest triangle at a point (x, y) of the bin's pixel, or -1."""
    planes = bins.triangles.planes
    nearest, nearest_depth = -1, -math.inf
    centre_x, centre_y = bins.pixel[bin_index] % bins.width + 0.5, bins.pixel[bin_index] // bins.width + 0.5
    for index in range(bins.first[bin_index], bins.first[bin_index + 1]):
        k = bins.members[index]
        if _depth_bound(planes, k, centre_x, centre_y) < nearest_depth:
            break  # the following triangles are farther still
        if covers(bins.triangles, k, x, y):
            depth = depth_at(bins.triangles, k, x, y)
            is_nearer = depth > nearest_depth or (depth == nearest_depth and k < nearest)
            if depth <= bins.triangles.max_depth and is_nearer:
                nearest, nearest_depth = k, depth
    return nearest

"""The exact area of disks in pixels, and its derivatives, on any array library."""

from __future__ import annotations

from loi_core.support.arrays import Array, namespace

__all__ = ["canvas_coverage", "disk_coverage"]


def disk_coverage(x: Array, y: Array, radius: Array) -> tuple[Array, Array, Array, Array]:
    """How much of each pixel disks about the origin cover.

    Parameters
    ----------
    x : array, shape (..., 1, w + 1)
        Abscissas of the pixels' edges, increasing by 1, relative to the centre of the disk.
    y : array, shape (..., h + 1, 1)
        Ordinates likewise.
    radius : array, shape (..., 1, 1)
        More than 0.

    Returns
    -------
    coverage, by_x, by_y, by_radius : arrays, shape (..., h, w)
        Area in [0, 1], and its derivatives by the centre and the radius of the disk.
    """
    xp = namespace(x)
    area, right, low, by_radius = (_per_pixel(part) for part in _quadrant(x, y, radius))
    # Moving the disk to the right is moving the pixels to the left.
    return xp.clip(area, 0.0, 1.0), -right, -low, by_radius


def canvas_coverage(positions: Array, radii: Array, columns: Array, rows: Array) -> tuple[Array, Array, Array, Array]:
    """How much of each pixel of a whole canvas each of `n` disks covers.

    Parameters
    ----------
    positions : array, shape (n, 2)
        Centres (x, y) in pixels.
    radii : array, shape (n,)
        In pixels; a disk of 0 or less covers nothing, and has no derivatives.
    columns : array, shape (w + 1,)
        Abscissas of the pixels' edges, increasing by 1.
    rows : array, shape (h + 1,)
        Ordinates likewise.

    Returns
    -------
    coverage, by_x, by_y, by_radius : arrays, shape (n, h, w)
        As :func:`disk_coverage`; exactly 0 in pixels that the disk's bounding box does not meet.
    """
    xp = namespace(positions)
    radius = radii[:, None, None]
    x = columns[None, None, :] - positions[:, 0, None, None]
    y = rows[None, :, None] - positions[:, 1, None, None]
    parts = disk_coverage(x, y, xp.where(radius > 0.0, radius, xp.ones_like(radius)))
    # Rounding, which compiled code may do differently from pixel to pixel, must not give a disk outside a gradient:
    # optimisers that normalise gradients would follow it.
    across = (x[..., 1:] > -radius) & (x[..., :-1] < radius)
    down = (y[:, 1:, :] > -radius) & (y[:, :-1, :] < radius)
    touched = across & down & (radius > 0.0)
    coverage, by_x, by_y, by_radius = (xp.where(touched, part, xp.zeros_like(part)) for part in parts)
    return coverage, by_x, by_y, by_radius


def _per_pixel(corners: Array) -> Array:
    """Integrals over pixels of what is integrated up to each of their corners, (..., h + 1, w + 1)."""
    rows = corners[..., 1:, :] - corners[..., :-1, :]
    return rows[..., :, 1:] - rows[..., :, :-1]


def _quadrant(x: Array, y: Array, radius: Array) -> tuple[Array, Array, Array, Array]:
    """Area of a disk about the origin to the left of `x` and above `y`, and its derivatives by x, y and radius."""
    xp = namespace(x)
    x = xp.minimum(xp.maximum(x, -radius), radius)
    y = xp.minimum(xp.maximum(y, -radius), radius)

    def half_chord(at: Array) -> Array:
        # As a product, since r * r - x * x at x = r is not 0 where a compiler fuses multiplication and subtraction.
        return xp.sqrt(xp.maximum((radius - at) * (radius + at), xp.zeros_like(at)))

    half_x, half_y = half_chord(x), half_chord(y)  # half the vertical chord at x, half the horizontal one at y

    def below_arc(at: Array) -> Array:
        """Integral of the half chord from 0 to `at`."""
        height = half_chord(at)
        # The angle is asin(at / radius), but where that is near 1 it would magnify the rounding of its argument.
        return 0.5 * (at * height + radius * radius * xp.atan2(at, height))

    # At abscissa t the chord from -h(t) to h(t) is cut at y where |t| < half_y; beyond, it lies wholly on one side.
    middle = xp.minimum(xp.maximum(x, -half_y), half_y)
    cut = below_arc(middle) + below_arc(half_y) + y * (middle + half_y)
    whole = below_arc(xp.minimum(x, -half_y)) + below_arc(xp.maximum(x, half_y))
    whole = whole + below_arc(radius) - below_arc(half_y)
    area = cut + xp.where(y >= 0.0, 2.0 * whole, xp.zeros_like(whole))
    chord_x = xp.minimum(y, half_x) + half_x
    chord_y = xp.minimum(x, half_y) + half_y
    by_x = xp.maximum(chord_x, xp.zeros_like(chord_x))
    by_y = xp.maximum(chord_y, xp.zeros_like(chord_y))
    # The area is homogeneous of degree 2 in (x, y, radius), so Euler's theorem gives the last derivative.
    return area, by_x, by_y, (2.0 * area - x * by_x - y * by_y) / radius

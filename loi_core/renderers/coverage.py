"""Exact area of disks in pixels, with derivatives, for any array library."""

from __future__ import annotations

from loi_core.support.arrays import Array, namespace

__all__ = ["canvas_coverage", "disk_coverage"]


def disk_coverage(x: Array, y: Array, radius: Array) -> tuple[Array, Array, Array, Array]:
    """Return the coverage of pixels by disks centred at the origin.

    Parameters
    ----------
    x : array, shape (..., 1, w + 1)
        x coordinates of pixel borders, increasing by 1, relative to the centre of the disk.
    y : array, shape (..., h + 1, 1)
        y coordinates likewise.
    radius : array, shape (..., 1, 1)
        More than 0.

    Returns
    -------
    coverage, by_x, by_y, by_radius : arrays, shape (..., h, w)
        Area in [0, 1], and its derivatives with respect to the centre and the radius of the disk.
    """
    xp = namespace(x)
    area, by_right, by_down, by_radius = (_per_pixel(integral) for integral in _quadrant(x, y, radius))
    # A shift of the disk to the right is a shift of the pixels to the left.
    return xp.clip(area, 0.0, 1.0), -by_right, -by_down, by_radius


def canvas_coverage(positions: Array, radii: Array, columns: Array, rows: Array) -> tuple[Array, Array, Array, Array]:
    """Return the coverage of every pixel of a canvas by each of `n` disks.

    Parameters
    ----------
    positions : array, shape (n, 2)
        Centres (x, y) in pixels.
    radii : array, shape (n,)
        In pixels; a disk with a radius of 0 or less has coverage and derivatives 0.
    columns : array, shape (w + 1,)
        x coordinates of pixel borders, increasing by 1.
    rows : array, shape (h + 1,)
        y coordinates likewise.

    Returns
    -------
    coverage, by_x, by_y, by_radius : arrays, shape (n, h, w)
        As :func:`disk_coverage`; exactly 0 in pixels outside the bounding box of the disk.
    """
    xp = namespace(positions)
    radius = radii[:, None, None]
    x = columns[None, None, :] - positions[:, 0, None, None]
    y = rows[None, :, None] - positions[:, 1, None, None]
    values = disk_coverage(x, y, xp.where(radius > 0.0, radius, xp.ones_like(radius)))
    # Rounding, which may vary between pixels in compiled code, must not give a disk outside the image a gradient:
    # optimisers that normalise gradients would follow it.
    overlaps_x = (x[..., 1:] > -radius) & (x[..., :-1] < radius)
    overlaps_y = (y[:, 1:, :] > -radius) & (y[:, :-1, :] < radius)
    touched = overlaps_x & overlaps_y & (radius > 0.0)
    coverage, by_x, by_y, by_radius = (xp.where(touched, value, xp.zeros_like(value)) for value in values)
    return coverage, by_x, by_y, by_radius


def _per_pixel(corners: Array) -> Array:
    """Return integrals over pixels from integrals up to their corners, shape (..., h + 1, w + 1)."""
    rows = corners[..., 1:, :] - corners[..., :-1, :]
    return rows[..., :, 1:] - rows[..., :, :-1]


def _quadrant(x: Array, y: Array, radius: Array) -> tuple[Array, Array, Array, Array]:
    """Return the area of a disk at the origin left of `x` and above `y`, and its derivatives in x, y and radius."""
    xp = namespace(x)
    x = xp.minimum(xp.maximum(x, -radius), radius)
    y = xp.minimum(xp.maximum(y, -radius), radius)

    def half_chord(t: Array) -> Array:
        # A product, since r * r - x * x at x = r is not 0 where a compiler fuses multiplication and subtraction.
        return xp.sqrt(xp.maximum((radius - t) * (radius + t), xp.zeros_like(t)))

    half_x, half_y = half_chord(x), half_chord(y)  # half the vertical chord at x, half the horizontal one at y

    def below_arc(t: Array) -> Array:
        """Return the integral of the half chord from 0 to `t`."""
        height = half_chord(t)
        # The angle is asin(t / radius), but near 1 asin magnifies the rounding error of its argument.
        return 0.5 * (t * height + radius * radius * xp.atan2(t, height))

    # At x = t, the chord from -h(t) to h(t) crosses y if |t| < half_y; otherwise it lies entirely on one side.
    middle = xp.minimum(xp.maximum(x, -half_y), half_y)
    crossed = below_arc(middle) + below_arc(half_y) + y * (middle + half_y)
    uncrossed = below_arc(xp.minimum(x, -half_y)) + below_arc(xp.maximum(x, half_y))
    uncrossed = uncrossed + below_arc(radius) - below_arc(half_y)
    area = crossed + xp.where(y >= 0.0, 2.0 * uncrossed, xp.zeros_like(uncrossed))
    chord_x = xp.minimum(y, half_x) + half_x
    chord_y = xp.minimum(x, half_y) + half_y
    by_x = xp.maximum(chord_x, xp.zeros_like(chord_x))
    by_y = xp.maximum(chord_y, xp.zeros_like(chord_y))
    # The area is homogeneous of degree 2 in (x, y, radius), so Euler's theorem gives the last derivative.
    return area, by_x, by_y, (2.0 * area - x * by_x - y * by_y) / radius

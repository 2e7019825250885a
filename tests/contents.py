"""Pairs of images of many kinds for tests of accuracy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from tests.helpers import Host

Pair = tuple[Host, Host]


def disks(shape: tuple[int, int, int], rng: np.random.Generator, count: int = 4, radius: float = 0.1) -> Host:
    """Return anti-aliased disks of random colour on black."""
    height, width, channels = shape
    image = np.zeros(shape)
    rows, columns = np.mgrid[:height, :width]
    for _ in range(count):
        distance = np.hypot(rows - rng.uniform(0, height), columns - rng.uniform(0, width))
        cover = np.clip(radius * min(height, width) + 0.5 - distance, 0.0, 1.0)[..., None]
        image = image * (1.0 - cover) + cover * rng.uniform(size=channels)
    return image


def photograph(shape: tuple[int, int, int], rng: np.random.Generator) -> Host:
    """Return an image with the statistics of photographs: a spectrum of 1 / frequency, and edges."""
    height, width, channels = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :])
    frequency[0, 0] = 1.0
    spectra = np.fft.fft2(rng.standard_normal((channels, height, width))) / frequency
    clouds = np.moveaxis(np.fft.ifft2(spectra).real, 0, -1)
    clouds = (clouds - clouds.min()) / (np.ptp(clouds) + 1e-12)
    mixed: Host = 0.6 * clouds + 0.4 * disks(shape, rng, 12, 0.15)
    return np.clip(mixed, 0.0, 1.0)


def _random(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    return rng.uniform(size=shape), rng.uniform(size=shape)


def _flat(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    return np.full(shape, rng.uniform()), np.full(shape, rng.uniform())


def _step(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    columns = np.arange(shape[1])[None, :, None] + np.zeros(shape)
    edges = rng.uniform(0.1, 0.9, 2) * shape[1]
    return np.where(columns < edges[0], 0.9, 0.1), np.where(columns < edges[1], 0.8, 0.2)


def _noisy(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    first, second = disks(shape, rng), disks(shape, rng)
    return (
        np.clip(first + 0.05 * rng.standard_normal(shape), 0, 1),
        np.clip(second + 0.05 * rng.standard_normal(shape), 0, 1),
    )


def _sparse(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    first, second = (rng.uniform(size=(*shape[:2], 1)) < 0.004 for _ in range(2))
    ones = np.ones(shape)
    ones[0, 0] = 0.0  # never all equal
    return first * ones, second * np.ones(shape) + 0.0 * ones


def _photographs(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    return photograph(shape, rng), photograph(shape, rng)


def _shifted(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    image = photograph(shape, rng)
    return image, np.roll(image, 3, axis=1)


CONTENTS: Final[dict[str, Callable[[tuple[int, int, int], np.random.Generator], Pair]]] = {
    "random": _random,
    "flat": _flat,
    "step": _step,
    "noisy": _noisy,
    "sparse": _sparse,
    "photographs": _photographs,
    "shifted": _shifted,
}
"""Image and reference, float64 in [0, 1], by kind."""


def _waves(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    """Two sines of one period and different phase, along an axis or oblique."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    angle = rng.choice([0.0, rng.uniform(0.0, np.pi)])
    phase = 2.0 * np.pi * rng.uniform(2.0, 20.0) * (columns * np.cos(angle) + rows * np.sin(angle)) / shape[1]
    return _grey(0.5 + 0.5 * np.sin(phase), shape), _grey(0.5 + 0.5 * np.sin(phase + rng.uniform(0.01, 3.0)), shape)


def _checkerboards(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    """A checkerboard, and the same board shifted, or grey."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    square = int(rng.integers(1, 17))
    board = (columns // square + rows // square) % 2 * rng.uniform(0.1, 1.0)
    if rng.random() < 0.3:
        return _grey(board, shape), np.full(shape, rng.uniform())
    return _grey(board, shape), _grey(np.roll(board, int(rng.integers(1, square + 1)), axis=1), shape)


def _stripes(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    """Vertical or horizontal stripes, one image shifted."""
    period = int(rng.integers(2, 40))
    width, moved = (int(rng.integers(1, period)) for _ in range(2))
    axis = int(rng.integers(2))
    position = np.mgrid[: shape[0], : shape[1]][axis]
    return _grey(position % period < width, shape), _grey((position + moved) % period < width, shape)


def _zone_plates(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    squared = (rows - shape[0] / 2) ** 2 + (columns - shape[1] / 2) ** 2
    phase = np.pi * rng.uniform(0.3, 1.0) * squared / max(shape[:2])
    return _grey(0.5 + 0.5 * np.cos(phase), shape), _grey(0.5 + 0.5 * np.cos(phase + rng.uniform(0.01, 3.0)), shape)


def _one_pixel(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    image = rng.uniform(size=shape) if rng.random() < 0.5 else np.full(shape, rng.uniform())
    reference = image.copy()
    reference[rng.integers(shape[0]), rng.integers(shape[1])] = rng.uniform(size=shape[2])
    return image, reference


def _disk_nearly_there(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    """The end of every fit: a disk less than a pixel off."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    centre = np.array([shape[0] // 2, shape[1] // 2]) if rng.random() < 0.5 else rng.uniform(0.3, 0.7, 2) * shape[:2]
    radius, angle = rng.uniform(0.05, 0.4) * min(shape[:2]), rng.choice([0.0, rng.uniform(0.0, 2.0 * np.pi)])
    moved = centre + 10.0 ** rng.uniform(-3.0, 0.0) * np.array([np.sin(angle), np.cos(angle)])
    image, reference = (np.clip(0.5 + radius - np.hypot(rows - y, columns - x), 0.0, 1.0) for y, x in (centre, moved))
    return _grey(image, shape), _grey(reference, shape)


def _box_nearly_there(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    """The end of a fit with edges along the axes."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    top, bottom = rng.uniform(0.0, 0.4) * shape[0], rng.uniform(0.6, 1.0) * shape[0]
    left, right = rng.uniform(0.0, 0.4) * shape[1], rng.uniform(0.6, 1.0) * shape[1]
    moved = 10.0 ** rng.uniform(-3.0, 0.0)
    level = np.clip(rows - top, 0.0, 1.0) * np.clip(bottom - rows, 0.0, 1.0)
    image, reference = (
        np.clip(columns - left - shift, 0, 1) * np.clip(right + shift - columns, 0, 1) for shift in (0.0, moved)
    )
    return _grey(level * image, shape), _grey(level * reference, shape)


def _photograph_nearly_there(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    image = photograph(shape, rng)
    waves = np.exp(2j * np.pi * 10.0 ** rng.uniform(-3.0, 0.0) * np.fft.fftfreq(shape[1]))[None, :, None]
    return image, np.clip(np.fft.ifft(np.fft.fft(image, axis=1) * waves, axis=1).real, 0.0, 1.0)


def _nearly_equal(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    image = rng.uniform(size=shape)
    size = 10.0 ** rng.uniform(-8.0, -1.0)
    return image, image + size * (rng.standard_normal(shape) if rng.random() < 0.7 else 1.0)


def _ramps(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    reference = rows / shape[0] if rng.random() < 0.5 else columns / shape[1] * rng.uniform(0.2, 1.0)
    return _grey(columns / shape[1] * rng.uniform(0.2, 1.0), shape), _grey(reference, shape)


def _grey(plane: Host, shape: tuple[int, int, int]) -> Host:
    return plane[..., None] * np.ones(shape)


HARD: Final[dict[str, Callable[[tuple[int, int, int], np.random.Generator], Pair]]] = {
    "waves": _waves,
    "checkerboards": _checkerboards,
    "stripes": _stripes,
    "zone plates": _zone_plates,
    "one pixel": _one_pixel,
    "a disk nearly there": _disk_nearly_there,
    "a box nearly there": _box_nearly_there,
    "a photograph nearly there": _photograph_nearly_there,
    "nearly equal": _nearly_equal,
    "ramps": _ramps,
}
"""Pairs whose blurred histogram differences change sign more often than the width of the blur suggests."""

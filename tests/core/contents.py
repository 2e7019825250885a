"""Pairs of images of the kinds that are compared: what an accuracy must hold on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from tests.helpers import Host

Pair = tuple[Host, Host]


def disks(shape: tuple[int, int, int], rng: np.random.Generator, count: int = 4, share: float = 0.1) -> Host:
    """Anti-aliased disks of random colour on black."""
    height, width, channels = shape
    image = np.zeros(shape)
    rows, columns = np.mgrid[:height, :width]
    for _ in range(count):
        away = np.hypot(rows - rng.uniform(0, height), columns - rng.uniform(0, width))
        cover = np.clip(share * min(height, width) + 0.5 - away, 0.0, 1.0)[..., None]
        image = image * (1.0 - cover) + cover * rng.uniform(size=channels)
    return image


def photograph(shape: tuple[int, int, int], rng: np.random.Generator) -> Host:
    """What photographs share: a spectrum that falls as 1 / frequency, and edges."""
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
    one, other = disks(shape, rng), disks(shape, rng)
    return (
        np.clip(one + 0.05 * rng.standard_normal(shape), 0, 1),
        np.clip(other + 0.05 * rng.standard_normal(shape), 0, 1),
    )


def _sparse(shape: tuple[int, int, int], rng: np.random.Generator) -> Pair:
    one, other = (rng.uniform(size=(*shape[:2], 1)) < 0.004 for _ in range(2))
    ones = np.ones(shape)
    ones[0, 0] = 0.0  # never all equal
    return one * ones, other * np.ones(shape) + 0.0 * ones


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

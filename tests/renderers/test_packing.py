"""Packed disks do not overlap, as if every pair had been examined."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from loi_core.renderers.packing import MAX_SWEEPS, separate_disks


@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.floats(0.5, 30.0))
def test_every_overlapping_pair_is_separated_by_half_the_overlap_each(seed: int, count: int, largest: float) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(8, 64)), int(rng.integers(8, 64))
    positions = rng.uniform(-10.0, 80.0, (count, 2))
    radii = largest * rng.uniform(0.1, 1.0, count)
    expected = pair_by_pair(positions, radii, size)
    assert np.allclose(separate_disks(positions, radii, size), expected, rtol=0.0, atol=1e-6)


def test_coincident_disks_are_separated() -> None:
    radii = np.full(5, 3.0)
    separated = separate_disks(np.full((5, 2), 32.0), radii, (64, 64))
    distances = np.linalg.norm(separated[:, None] - separated[None], axis=-1)[np.triu_indices(5, 1)]
    assert distances.min() > 3.0


def pair_by_pair(
    positions: NDArray[np.float64], radii: NDArray[np.float64], size: tuple[int, int]
) -> NDArray[np.float64]:
    frame = np.array(size[::-1], dtype=np.float64)
    margin = np.minimum(radii[:, None], frame / 2)
    positions = np.clip(positions, margin, frame - margin)
    for _ in range(MAX_SWEEPS):
        moved = positions.copy()
        for first in range(len(radii)):
            for second in range(first):
                offset = positions[first] - positions[second]
                distance = np.linalg.norm(offset)
                assume(distance > 1e-6)  # two disks in a corner have no direction of separation
                overlap = radii[first] + radii[second] - distance
                if overlap > 0.0:
                    shift = 0.5 * overlap * offset / distance
                    moved[first] += shift
                    moved[second] -= shift
        positions = np.clip(moved, margin, frame - margin)
    return positions

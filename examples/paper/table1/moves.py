"""The separation of overlapping disks in the released code, to reproduce its protocol."""

from __future__ import annotations

import numpy as np

from examples.paper.table1.problem import RADIUS, FloatArray
from examples.paper.table1.renderers import DisksWrapper
from loi_core.renderers.packing import candidate_pairs

__all__ = ["ReleasedMoves"]

MAX_ROUNDS = 50
PUSH_PX = 0.5  # in a round, for each overlapping disk


class ReleasedMoves(DisksWrapper):
    """Disks clipped to two radii inside the frame, then pushed half a pixel away from every disk that they overlap.

    Concentric disks are not pushed apart. After the pushes a centre may be anywhere in the frame.
    """

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the parameters with separated disks, as the released code renders them."""
        height, width = self.disks.size
        frame = np.array([width, height], dtype=np.float64)
        positions = np.clip(params["positions"].astype(np.float64), 2.0 * RADIUS, frame - 2.0 * RADIUS)
        radii = np.full(len(positions), RADIUS)
        for _ in range(MAX_ROUNDS):
            first, second = candidate_pairs(positions, radii)
            offset = positions[first] - positions[second]
            distance = np.hypot(offset[:, 0], offset[:, 1])
            overlapping = np.flatnonzero((distance < 2.0 * RADIUS) & (distance > 0.0))
            if not len(overlapping):
                break
            push = PUSH_PX * offset[overlapping] / distance[overlapping, None]
            np.add.at(positions, first[overlapping], push)
            np.subtract.at(positions, second[overlapping], push)
            positions = np.clip(positions, 0.0, frame)
        return params | {"positions": positions.astype(params["positions"].dtype)}

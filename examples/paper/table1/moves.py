"""Parting disks as the released code does, to reproduce its protocol."""

from __future__ import annotations

import numpy as np

from examples.paper.table1.problem import RADIUS, FloatArray
from examples.paper.table1.renderers import DisksWrapper
from loi_core.renderers.packing import candidate_pairs

__all__ = ["ReleasedMoves"]

ROUNDS = 50
PUSH = 0.5  # pixels in a round, for each disk that is touched


class ReleasedMoves(DisksWrapper):
    """`disks`, kept two radii from the frame and pushed apart by half a pixel for each disk that they touch.

    Disks in exactly the same place are not pushed. After the pushes a centre may be anywhere in the frame.
    """

    def project(self, params: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """What the released code does before each render."""
        height, width = self.disks.size
        frame = np.array([width, height], dtype=np.float64)
        places = np.clip(params["positions"].astype(np.float64), 2.0 * RADIUS, frame - 2.0 * RADIUS)
        radii = np.full(len(places), RADIUS)
        for _ in range(ROUNDS):
            first, second = candidate_pairs(places, radii)
            apart = places[first] - places[second]
            distance = np.hypot(apart[:, 0], apart[:, 1])
            touching = np.flatnonzero((distance < 2.0 * RADIUS) & (distance > 0.0))
            if not len(touching):
                break
            push = PUSH * apart[touching] / distance[touching, None]
            np.add.at(places, first[touching], push)
            np.subtract.at(places, second[touching], push)
            places = np.clip(places, 0.0, frame)
        return params | {"positions": places.astype(params["positions"].dtype)}

"""Tolerances of the visibility pass."""

from __future__ import annotations

from typing import Final

__all__ = [
    "BIN_MARGIN_PX",
    "DEGENERATE_AREA_RATIO",
    "MAX_INTERSECTING_TRIANGLES",
    "MAX_RELATIVE_CONTACT_DEPTH",
    "N_BISECTIONS",
    "QUERY_OFFSET_PX",
    "SAME_POSITION_PX",
]

QUERY_OFFSET_PX: Final = 1e-6  # distance from an edge of the two visibility queries beside it
DEGENERATE_AREA_RATIO: Final = 1e-9  # twice a triangle's area over its squared longest side, if it is seen edge-on
MAX_RELATIVE_CONTACT_DEPTH: Final = 1e-9  # relative difference of depth up to which two surfaces touch
SAME_POSITION_PX: Final = 1e-5
BIN_MARGIN_PX: Final = 2e-3  # distance beyond a pixel at which triangles are still binned to it
MAX_INTERSECTING_TRIANGLES: Final = 24  # nearest triangles of a pixel that are tested for intersection
N_BISECTIONS: Final = 14  # of an edge within a pixel, to find where its visibility changes

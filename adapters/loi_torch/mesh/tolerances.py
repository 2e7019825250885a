"""Tolerances of the visibility pass."""

from __future__ import annotations

from typing import Final

__all__ = ["ASIDE", "EDGE_ON", "HALVINGS", "MARGIN", "PAIRED", "SAME_DEPTH", "SAME_PLACE"]

ASIDE: Final = 1e-6  # pixels from an edge at which its two sides are looked at
EDGE_ON: Final = 1e-9  # of the square of its longest side: twice the area of a triangle that counts as seen edge-on
SAME_DEPTH: Final = 1e-9  # relative: surfaces this near to each other touch
SAME_PLACE: Final = 1e-5  # pixels
MARGIN: Final = 2e-3  # pixels by which lists of a pixel's triangles look beyond it
PAIRED: Final = 24  # of a pixel's triangles, the nearest, that are looked at for where they cut into each other
HALVINGS: Final = 14  # of the part of an edge within a pixel, to find where it comes to light

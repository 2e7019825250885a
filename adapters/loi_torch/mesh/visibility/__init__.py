"""Visibility of triangles and edges, by loops that Numba compiles.

The depth buffer gives the visible triangle at each pixel's centre (``edge_functions``). Silhouettes, boundaries and
creases are cut at pixel borders (``edge_walk``), and the visible segments are found by visibility queries beside the
edges, among the triangles binned to each pixel (``bins``). ``intersections`` finds the visible intersections of
triangles.
"""

from __future__ import annotations

from loi_core.errors import BackendNotFoundError
from loi_core.method import compiled
from loi_core.support.wording import described
from loi_torch.mesh.visibility.types import ProjectedScene, VisibleSegments

__all__ = ["find_visible"]


def find_visible(scene: ProjectedScene) -> VisibleSegments:
    """Return the visible triangles and edge segments of a projected scene, without gradients.

    Raises
    ------
    BackendNotFoundError
        If Numba cannot be imported.
    """
    compiled.available()  # imports Numba under a lock: its import fails if two threads start it
    try:
        from loi_torch.mesh.visibility import numba
    except ImportError as error:
        msg = f"meshes need Numba, which cannot be imported ({described(error)}): pip install numba"
        raise BackendNotFoundError(msg) from error
    return numba.find_visible(scene)

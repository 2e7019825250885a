"""Visibility of triangles and edges, by loops that Numba compiles."""

from __future__ import annotations

from loi_core.errors import BackendNotFoundError
from loi_core.method import compiled
from loi_core.support.wording import described
from loi_torch.mesh.projected import Projected, Seen

__all__ = ["look"]


def look(scene: Projected) -> Seen:
    """Return the visible triangles and edge segments of a projected scene, without gradients."""
    compiled.available()  # imports Numba under a lock: its import fails if two threads start it
    try:
        from loi_torch.mesh.loops import visible
    except ImportError as error:
        msg = f"meshes need Numba, which cannot be imported ({described(error)}): pip install numba"
        raise BackendNotFoundError(msg) from error
    return visible.look(scene)

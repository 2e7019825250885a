"""What is visible: by compiled loops where Numba is, by operations on whole arrays elsewhere."""

from __future__ import annotations

from loi_core.method import compiled
from loi_torch.mesh.projected import Projected, Seen

__all__ = ["look"]


def look(scene: Projected) -> Seen:
    """What is seen of a projected scene; none of it carries a gradient."""
    if compiled.available():
        from loi_torch.mesh.loops import visible

        return visible.look(scene)
    from loi_torch.mesh import visible_arrays

    return visible_arrays.look(scene)

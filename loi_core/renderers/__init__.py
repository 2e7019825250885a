"""Renderers on the NumPy backend, with hand-written pullbacks."""

from loi_core.renderers.disks import Disks
from loi_core.renderers.warp import Warp

__all__ = ["Disks", "Warp"]

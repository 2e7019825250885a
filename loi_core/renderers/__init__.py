"""Renderers on the NumPy backend, with hand-written pullbacks, and gradients by blurring for those of any backend."""

from loi_core.renderers.blurred import BlurredRenderer
from loi_core.renderers.disks import Disks
from loi_core.renderers.warp import Warp

__all__ = ["BlurredRenderer", "Disks", "Warp"]

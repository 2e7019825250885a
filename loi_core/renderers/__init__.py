"""NumPy renderers with hand-written pullbacks, and blurred gradients for any renderer."""

from loi_core.renderers.blurred import BlurredRenderer
from loi_core.renderers.disks import Disks
from loi_core.renderers.warp import Warp

__all__ = ["BlurredRenderer", "Disks", "Warp"]

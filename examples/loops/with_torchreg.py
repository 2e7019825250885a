"""Register a disk with torchreg: ``python -m examples.loops.with_torchreg``, which needs ``pip install torchreg``."""

import torch
from torchreg import AffineRegistration

from loi_torch.kornia import LOILoss

size = 64
rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")


def disk(x: float, y: float) -> torch.Tensor:
    """Draw a grey disk, shape (1, 1, H, W)."""
    return (0.2 + 0.6 * (5.5 - torch.hypot(columns - x, rows - y)).clamp(0.0, 1.0))[None, None]


def shift(loss: torch.nn.Module) -> list[float]:
    """Return by how many pixels torchreg moves the disk; (-24, -19) is right."""
    registration = AffineRegistration(
        scales=(2, 1),
        iterations=(100, 100),
        is_3d=False,
        learning_rate=0.02,
        verbose=False,
        dissimilarity_function=loss,
        with_rotation=False,
        with_zoom=False,
    )
    registration(disk(44.0, 42.0), disk(20.0, 23.0))
    # An affine map from the target's coordinates to the source's, both from -1 to 1 between the outer pixels' centres.
    return [round(-0.5 * (size - 1) * value, 1) for value in registration.get_affine()[0, :, 2].tolist()]


print("L2 ", shift(torch.nn.MSELoss()))
print("loi", shift(LOILoss()))

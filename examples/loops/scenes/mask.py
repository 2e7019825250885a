"""A disk as a mask, in place of roboreg's renderer of robots."""

import torch

ROWS, COLUMNS = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(64) + 0.5, indexing="ij")


def render(centre: torch.Tensor) -> torch.Tensor:
    """Render the soft mask of a disk, shape (1, H, W, 1)."""
    return torch.sigmoid(6.0 - torch.hypot(COLUMNS - centre[0], ROWS - centre[1]))[None, ..., None]


def measured() -> torch.Tensor:
    """Return the mask of a disk at (50, 34), shape (1, H, W)."""
    return (torch.hypot(COLUMNS - 50.0, ROWS - 34.0) < 6.0)[None]

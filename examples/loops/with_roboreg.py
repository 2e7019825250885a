"""A rendering objective for roboreg, which registers a camera to a robot by masks.

roboreg takes a ``RenderingObjective``: three methods, whose renders have shape (B, H, W, 1), as images have here.
``python -m examples.loops.with_roboreg`` moves a mask as roboreg does, with a stand-in for its renderer of robots.
"""

from collections.abc import Callable
from typing import Any

import torch

import loi_torch
from examples.loops.scenes import mask


class LOIObjective:
    """The locally orderless image loss of masks, shape (B, H, W), and renders, shape (B, H, W, 1)."""

    def __init__(self) -> None:
        self._loss = loi_torch.LOILoss()

    def validate_targets(self, targets: torch.Tensor) -> None:
        """Raise a ValueError unless targets are in [0, 1]."""
        if not torch.all((targets >= 0) & (targets <= 1)):
            msg = "targets must be in [0, 1]"
            raise ValueError(msg)

    def preprocess_targets(self, targets: torch.Tensor) -> torch.Tensor:
        """Return targets with a channel, shape (B, H, W, 1), like renders."""
        return targets.to(torch.float32).unsqueeze(-1)

    def __call__(self, preprocessed_targets: torch.Tensor, renders: torch.Tensor) -> torch.Tensor:
        """Return the loss, shape ()."""
        value: torch.Tensor = self._loss(renders, preprocessed_targets)
        return value


def fitted_centre(objective: Callable[..., Any], targets: torch.Tensor) -> list[float]:
    """Return the centre that Adam reaches; (50, 34) is right."""
    centre = torch.tensor([12.0, 12.0], requires_grad=True)
    optimizer = torch.optim.Adam([centre], lr=1.0)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 120)
    for _ in range(120):
        optimizer.zero_grad()
        objective(targets, mask.render(centre)).backward()
        optimizer.step()
        schedule.step()
    return [round(value, 1) for value in centre.tolist()]


objective = LOIObjective()
objective.validate_targets(mask.measured())
targets = objective.preprocess_targets(mask.measured())
print("L2 ", fitted_centre(torch.nn.functional.mse_loss, targets))
print("loi", fitted_centre(objective, targets))

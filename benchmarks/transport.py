"""What one matching of RGBXY takes: geomloss's Sinkhorn, and POT's exact transport, as a Markdown table.

Points are drawn evenly in five dimensions, and all count alike. The error is how far matches are from the exact ones on
average, and the cost the mean squared distance of points from their matches.

    python -m benchmarks.transport    # a minute, with what `make bench` installs
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np
import ot
import torch
from geomloss import SamplesLoss
from torch import Tensor

from loi_core.support.markdown import markdown

__all__ = ["main"]

BLUR: Final = 0.01  # as published, and as loi_torch.rgbxy has it
COUNTS: Final = (256, 1024, 4096)
TURNS: Final = 3


def main() -> None:
    """Print the table."""
    rows = []
    for count in COUNTS:
        numbers = torch.Generator().manual_seed(count)
        points, wanted = (torch.rand(count, 5, generator=numbers) for _ in range(2))
        exact = _exact(points, wanted)
        for name, match in (("geomloss, Sinkhorn", _sinkhorn), ("POT, exact", _exact)):
            seconds, found = _timed(match, points, wanted)
            error = float((found - exact).norm(dim=1).mean())
            cost = float(((found - points) ** 2).sum(dim=1).mean())
            rows.append([f"{count}", name, f"{seconds:.3f}", f"{error:.3f}", f"{cost:.4f}"])
    print("\n".join(markdown(["points", "", "seconds", "error", "cost"], rows)))


def _sinkhorn(points: Tensor, wanted: Tensor) -> Tensor:
    own = points.clone().requires_grad_()
    cost = SamplesLoss("sinkhorn", blur=BLUR, backend="tensorized")(own, wanted) * len(own)
    return points - torch.autograd.grad(cost, own)[0]


def _exact(points: Tensor, wanted: Tensor) -> Tensor:
    alike = np.full(len(points), 1.0 / len(points))
    squares = torch.cdist(points.double(), wanted.double()).numpy() ** 2
    plan = ot.emd(alike, alike, squares, numItermax=10**7)
    return torch.as_tensor(len(points) * plan @ wanted.double().numpy()).to(points)


def _timed(match: Callable[[Tensor, Tensor], Tensor], points: Tensor, wanted: Tensor) -> tuple[float, Tensor]:
    """The median of a few, after one that does not count."""
    found, times = match(points, wanted), []
    for _ in range(TURNS):
        began = time.perf_counter()
        found = match(points, wanted)
        times.append(time.perf_counter() - began)
    return float(np.median(times)), found


if __name__ == "__main__":
    main()

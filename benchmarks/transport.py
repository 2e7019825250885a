"""What one matching of RGBXY takes: geomloss's Sinkhorn, and POT's exact transport, as a Markdown table.

Points are those of Table 3's first views, at the start and at the target: means of blocks of pixels. The error is how
far matches are from the exact ones on average, in sides of the image, and the way how far they are from the points.

    python -m benchmarks.transport    # three minutes, with what `make bench` installs
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import ot
import torch
from geomloss import SamplesLoss
from torch import Tensor
from torch.nn import functional

from examples.paper.table3.problem import COLUMNS, FloatArray, Problem
from loi_core.support.markdown import markdown

__all__ = ["main"]

BLUR: Final = 0.01  # as in the released code, and in loi_torch.rgbxy
NAMES: Final = ("Translation", "Trans. + Rot.", "Material")
GRIDS: Final = (32, 64)
TURNS: Final = 3


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    rows = []
    for column, grid in itertools.product(COLUMNS, GRIDS):
        if column.name not in NAMES:
            continue
        problem = Problem.of(column, 0)
        points, wanted = (_points(problem, some, grid) for some in (problem.start, problem.goal))
        exact = _exact(points, wanted)
        for name, match in (("geomloss, Sinkhorn", _sinkhorn), ("POT, exact", _exact)):
            seconds, found = _timed(match, points, wanted)
            error, way = (float((found - some).norm(dim=1).mean()) for some in (exact, points))
            rows.append([column.name, f"{grid**2}", name, f"{seconds:.3f}", f"{error:.3f}", f"{way:.3f}"])
    print("\n".join(markdown(["column", "points", "", "seconds", "error", "way"], rows)))


def _points(problem: Problem, at: Mapping[str, FloatArray], grid: int) -> Tensor:
    """Means of blocks of the first view, shape (grid * grid, 5)."""
    params = {name: torch.as_tensor(value, dtype=torch.float32) for name, value in at.items()}
    image = next(iter(problem.places.values())).render(params)
    return functional.adaptive_avg_pool2d(image.detach().movedim(2, 0), grid).movedim(0, 2).reshape(-1, 5).float()


def _sinkhorn(points: Tensor, wanted: Tensor) -> Tensor:
    own = points.clone().requires_grad_()
    cost = SamplesLoss("sinkhorn", blur=BLUR, backend="tensorized")(own, wanted) * len(own)
    return points - torch.autograd.grad(cost, own)[0]


def _exact(points: Tensor, wanted: Tensor) -> Tensor:
    alike = np.full(len(points), 1.0 / len(points))
    plan = ot.emd(alike, alike, ot.dist(points.double().numpy(), wanted.double().numpy()), numItermax=10**9)
    return wanted[torch.as_tensor(plan.argmax(axis=1))]


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

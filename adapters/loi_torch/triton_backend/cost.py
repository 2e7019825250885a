"""The cost of a comparison on a GPU, from a run without data or a GPU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from loi_core.method.planner import make_plan
from loi_core.method.scales import ScaleSpace
from loi_torch.triton_backend.comparison import TritonComparison
from loi_torch.triton_backend.launching import Launch, Recorder

__all__ = ["ComparisonCost", "cost_of"]


@dataclass(frozen=True)
class ComparisonCost:
    """The cost of one evaluation of the loss and its gradient on a GPU.

    Attributes
    ----------
    launches : tuple of Launch
        The kernels of one evaluation, in order.
    peak_bytes : int
        The most memory that is allocated at once, beside image, reference and the tables of the blurs.
    """

    launches: tuple[Launch, ...]
    peak_bytes: int

    @property
    def operations(self) -> float:
        """Multiplications and additions; an exponential counts as some (:data:`.launching.EXPONENTIAL`)."""
        return sum(launch.operations for launch in self.launches)

    def seconds(self, bandwidth: float = 3e12, operations: float = 3e13, launch: float = 1.5e-6) -> float:
        """Return a lower bound on the time, for bytes and operations per second, and seconds per launch."""
        return sum(launch + max(one.bytes / bandwidth, one.operations / operations) for one in self.launches)


def cost_of(
    scales: ScaleSpace, height: int, width: int, *, planes: int = 3, weighted: bool = False, gradient: bool = True
) -> ComparisonCost:
    """Return the cost of comparing `planes` planes: the channels of all images of a batch."""
    eps = float(np.finfo(np.float32).eps)
    plan = make_plan(scales, height, width, tolerance=0.0, eps=eps, weighted=weighted)
    run = Recorder()
    image = torch.empty(planes, height, width, device=run.device)
    comparison = TritonComparison.of(scales, plan, image, image if weighted else None, run)
    run.launches.clear()
    comparison.compare(image, gradient=gradient)
    return ComparisonCost(tuple(run.launches), run.peak)

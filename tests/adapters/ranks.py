"""One rank of several, for the tests of views over processes: ``python -m tests.adapters.ranks RANK RANKS FILE``.

It goes through the same steps as all others, and prints what it has found as JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any, Final

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor

from loi_core import ScaleSpace
from loi_core.errors import LoiError
from loi_torch import LOILoss
from loi_torch.distributed import mean_over_views, sum_gradients

PATIENCE: Final = 2.0  # seconds for which ranks wait for one that does not come
SIZES: Final = ((16, 12), (9, 20), (24, 8), (12, 12), (10, 17))  # of the views
DIVISIONS: Final = {2: ((0, 4, 5),), 3: ((0, 1, 3, 5), (0, 3, 5, 5))}
"""Where the views of each rank begin and end: by the number of ranks, some ways to divide them."""


def parameters() -> list[Tensor]:
    """What all views share: two parameters, the second of which not every view depends on."""
    start = np.random.default_rng(0).normal(size=(2, 3))
    return [torch.tensor(each, dtype=torch.float32, requires_grad=True) for each in start]


def loss_of(view: int, shared: list[Tensor]) -> Tensor:
    """The loss of one view of what is shared."""
    height, width = SIZES[view]
    rng = np.random.default_rng(view + 1)
    reference = rng.uniform(size=(height, width, 3)).astype(np.float32)
    pattern = torch.tensor(rng.normal(size=(height, width, 3)), dtype=torch.float32)
    light = shared[0] + shared[1] if view % 2 else shared[0]
    loss: Tensor = LOILoss(reference, ScaleSpace(1, (1, 3), 0.25))(torch.sigmoid(pattern + light))
    return loss


def bits(tensor: Tensor | None) -> list[str]:
    """Its numbers, so that nothing is lost in writing them."""
    assert tensor is not None
    return [float(one).hex() for one in tensor.detach().reshape(-1)]


def losses_of(views: range, shared: list[Tensor]) -> Tensor:
    return torch.stack([loss_of(view, shared) for view in views]) if views else torch.zeros(0)


def together(views: range, group: dist.ProcessGroup) -> dict[str, list[str]]:
    """Value and gradients as this rank gets them, when it has these views."""
    shared = parameters()
    mean = mean_over_views(losses_of(views, shared), group=group)
    mean.backward()  # type: ignore[no-untyped-call]
    sum_gradients(shared, group=group)
    return {"value": bits(mean), "gradient": [bit for one in shared for bit in bits(one.grad)]}


class Scene(torch.nn.Module):
    """For DistributedDataParallel: what is shared, and the losses of some views of it."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = (torch.nn.Parameter(one.detach()) for one in parameters())

    def forward(self, views: range) -> Tensor:
        return losses_of(views, [self.first, self.second])


def by_ddp(views: range, group: dist.ProcessGroup) -> dict[str, list[str]]:
    """The same by DistributedDataParallel."""
    scene = Scene()
    spread = torch.nn.parallel.DistributedDataParallel(scene, process_group=group, find_unused_parameters=True)
    losses = spread(views)
    mean = mean_over_views(losses, group=group)
    (mean * dist.get_world_size(group)).backward()  # type: ignore[no-untyped-call]
    return {"value": bits(mean), "gradient": [bit for one in scene.parameters() for bit in bits(one.grad)]}


def refused(call: Callable[[], Any]) -> dict[str, Any]:
    """The error that a call ends with, and after how many seconds."""
    started = time.monotonic()
    try:
        call()
    except LoiError as error:
        return {"kind": type(error).__name__, "says": str(error), "seconds": time.monotonic() - started}
    return {"kind": "", "says": "", "seconds": time.monotonic() - started}


def main(rank: int, ranks: int, file: str) -> None:
    torch.set_num_threads(1)
    enough = timedelta(seconds=60)
    dist.init_process_group("gloo", init_method=f"file://{file}", rank=rank, world_size=ranks, timeout=enough)
    found: dict[str, Any] = {}
    for number, divisions in DIVISIONS.items():
        group = dist.new_group(list(range(number)), timeout=enough)
        for division in divisions:
            if rank < number:
                views = range(division[rank], division[rank + 1])
                found[f"{number} {division}"] = together(views, group)
                if 0 not in np.diff(division):
                    found[f"{number} {division} ddp"] = by_ddp(views, group)
    found["no view"] = refused(lambda: mean_over_views(torch.zeros(0)))
    some = [torch.zeros(2 + rank, requires_grad=True)]
    found["other sizes"] = refused(lambda: sum_gradients(some))
    slow = dist.new_group(list(range(ranks)), timeout=timedelta(seconds=PATIENCE))
    if rank == ranks - 1:
        print(json.dumps(found), flush=True)
        time.sleep(2.0 * PATIENCE)
        os._exit(1)  # without having come
    found["slow"] = refused(lambda: mean_over_views(torch.ones(1), group=slow))
    found["dead"] = refused(lambda: sum_gradients(parameters()))
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])

"""One fit by the processes of ``torch.distributed``, each of which renders some of the views.

The objective of several views is the mean of their losses, as in :func:`loi_core.fit`. Every process, or *rank*,
compares the views that it has; :func:`mean_over_views` makes the mean over those of all ranks, and
:func:`sum_gradients` adds what each has found for the parameters that they share::

    losses = torch.stack([loss(render(params, camera)) for loss, camera in mine])
    mean_over_views(losses).backward()
    sum_gradients([params])
    optimizer.step()

Ranks may have different numbers of views, of different sizes, or none. They have to call both functions equally often.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from loi_core.errors import DistributedError, OptionError
from loi_core.support.wording import described, shown

__all__ = ["mean_over_views", "sum_gradients"]


def mean_over_views(losses: Tensor, *, group: dist.ProcessGroup | None = None) -> Tensor:
    """The mean of the losses of all views of all ranks, the same number on each.

    Its gradient by `losses` is that of this rank's part of the mean, ``1 / views``: what depends on the losses of
    several ranks has the sum of their gradients, see :func:`sum_gradients`. ``DistributedDataParallel`` takes the mean
    over ranks instead; with it, multiply by their number: ``(mean_over_views(losses) * world_size).backward()``.

    Parameters
    ----------
    losses : Tensor, shape (n,)
        One for each view that this rank has; n may be 0, and differ from rank to rank.
    group : ProcessGroup, optional
        The ranks; all of them by default.

    Returns
    -------
    Tensor, shape ()
        Of the dtype and device of `losses`. Added up in float64 in the order of ranks, so that it is the same to the
        last bit however views, in that order, are divided among ranks.

    Raises
    ------
    OptionError
        If `losses` has another shape or dtype, or no rank has a view.
    DistributedError
        If there is no process group, or a rank has failed, or does not come within the timeout of the group.
    """
    if not isinstance(losses, Tensor) or losses.ndim != 1 or not losses.is_floating_point():
        got = f"{losses.dtype} of shape {tuple(losses.shape)}" if isinstance(losses, Tensor) else shown(losses)
        msg = f"`losses` must be a floating-point tensor of shape (views,), got {got}"
        raise OptionError(msg)
    with _together("mean_over_views", group):
        values = _gathered(losses.detach().double(), group)
    if not values.numel():
        msg = "`losses` must hold the loss of at least one view on some rank, got none on any"
        raise OptionError(msg)
    if not losses.numel() and torch.is_grad_enabled():
        losses = losses.detach().requires_grad_()  # so that `backward` can be called here as elsewhere
    mean: Tensor = _Mean.apply(losses, values.mean().to(losses.dtype), values.numel())  # type: ignore[no-untyped-call]  # untyped in torch
    return mean


def sum_gradients(parameters: Iterable[Tensor], *, group: dist.ProcessGroup | None = None) -> None:
    """Put into ``grad`` of each parameter the sum of what it holds on all ranks.

    Parameters
    ----------
    parameters : iterable of Tensor
        The same on all ranks, in the same order; a rank that has no gradient for one adds 0. Those that require no
        gradient are left out.
    group : ProcessGroup, optional
        The ranks; all of them by default.

    Raises
    ------
    OptionError
        If the ranks have parameters of different sizes.
    DistributedError
        If there is no process group, or a rank has failed, or does not come within the timeout of the group.
    """
    alike: dict[tuple[torch.dtype, torch.device], list[Tensor]] = {}
    for one in parameters:
        if one.requires_grad:
            alike.setdefault((one.dtype, one.device), []).append(one)
    with _together("sum_gradients", group):
        for (_, device), some in alike.items():
            flat = torch.cat([_gradient(one).reshape(-1) for one in some])
            sizes = _one_each(torch.tensor(flat.numel(), device=device), group)
            if len(set(sizes)) > 1:
                msg = f"`parameters` must be the same on all ranks, got {sizes} numbers of {flat.dtype} by rank"
                raise OptionError(msg)
            dist.all_reduce(flat, group=group)
            for one, part in zip(some, torch.split(flat, [one.numel() for one in some]), strict=True):
                one.grad = part.reshape(one.shape).clone()


class _Mean(torch.autograd.Function):
    """The mean over all ranks, whose gradient by the losses of this one is known without asking the others."""

    @staticmethod
    def forward(ctx: Any, losses: Tensor, mean: Tensor, count: int) -> Tensor:
        ctx.own, ctx.count = losses.shape, count
        return mean.clone()

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        return (upstream / ctx.count).expand(ctx.own), None, None


def _gradient(parameter: Tensor) -> Tensor:
    return torch.zeros_like(parameter) if parameter.grad is None else parameter.grad


def _gathered(own: Tensor, group: dist.ProcessGroup | None) -> Tensor:
    """The vectors of all ranks, one after another."""
    counts = _one_each(torch.tensor(own.numel(), device=own.device), group)
    padded = own.new_zeros(max(counts))
    padded[: own.numel()] = own
    all_of_them = [torch.empty_like(padded) for _ in counts]
    dist.all_gather(all_of_them, padded, group=group)
    return torch.cat([each[:count] for each, count in zip(all_of_them, counts, strict=True)])


def _one_each(number: Tensor, group: dist.ProcessGroup | None) -> list[int]:
    """The number, shape (), of each rank."""
    numbers = [torch.empty_like(number) for _ in range(dist.get_world_size(group))]
    dist.all_gather(numbers, number, group=group)
    return [int(each) for each in numbers]


@contextmanager
def _together(name: str, group: dist.ProcessGroup | None) -> Iterator[None]:
    """Say what it means if others do not come."""
    if not dist.is_available() or not dist.is_initialized():
        msg = f"{name} needs a process group: call torch.distributed.init_process_group first, and start by torchrun"
        raise DistributedError(msg)
    try:
        yield
    except RuntimeError as error:
        msg = (
            f"rank {dist.get_rank(group)} of {dist.get_world_size(group)} waited in {name} for others in vain: one has "
            f"failed, or takes longer than the `timeout` of init_process_group ({described(error)})"
        )
        raise DistributedError(msg) from error

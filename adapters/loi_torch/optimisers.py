"""Optimisers of torch.optim in a fit, for renderers of any library."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from loi_core.errors import OptionError, ParameterError, UnknownOptionError
from loi_core.fitting.optimiser import Memory
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host, from_numpy, to_numpy
from loi_core.support.keywords import guess
from loi_core.support.wording import shown

__all__ = ["TorchOptimiser"]

NUMBER_SUFFIX: Final = "#"
"""Suffix of entries of the state that are Python numbers."""

STEP_KEY: Final = "step"


class TorchOptimiser:
    """An optimiser of torch.optim, for :func:`loi_core.fit`.

    Parameters
    ----------
    optimiser_class : class
        Any class that steps without a closure, such as ``torch.optim.NAdam``.
    **options
        Its options except ``lr``: the fit sets the rate of every parameter in every step. (Rprop adapts its step sizes
        and uses rates in its first step only.)

    Raises
    ------
    OptionError
        If `optimiser_class` is no such class, or does not take the options; the message guesses at a misspelt one.

    Examples
    --------
    >>> import torch
    >>> optimiser = TorchOptimiser(torch.optim.SGD, momentum=0.9)
    >>> # fit(renderer, objective, optimiser=optimiser, learning_rate=1e3)
    """

    def __init__(self, optimiser_class: type[torch.optim.Optimizer], **options: Any) -> None:
        if not (isinstance(optimiser_class, type) and issubclass(optimiser_class, torch.optim.Optimizer)):
            msg = f"`optimiser_class` must be a class of torch.optim, such as NAdam, got {shown(optimiser_class)}"
            raise OptionError(msg)
        if issubclass(optimiser_class, torch.optim.LBFGS):
            msg = "`optimiser_class` must step without a closure, which LBFGS does not; Adam, NAdam, RMSprop and SGD do"
            raise OptionError(msg)
        if "lr" in options:
            msg = "`lr` is set by the fit in every step; give it `learning_rate` instead"
            raise OptionError(msg)
        known = [name for name in inspect.signature(optimiser_class).parameters if name not in ("params", "lr")]
        for option in options:
            if option not in known:
                msg = f"{optimiser_class.__name__} takes no option `{option}`; {guess(option, known)}"
                raise UnknownOptionError(msg)
        self._kind, self._options = optimiser_class, options
        self._make([torch.zeros(2, 2)], [1.0])

    def start(self, params: Parameters, previous: Memory | None = None) -> Memory:  # noqa: ARG002  # the state starts empty
        """See :class:`loi_core.Optimiser`."""
        return {}

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """See :class:`loi_core.Optimiser`."""
        leaves = {name: _wide(_tensor(params[name])).clone().requires_grad_() for name in rates}
        optimiser = self._make(list(leaves.values()), list(rates.values()))
        states: dict[str, dict[str, Any]] = {}
        for key, value in memory.items():
            name, entry = key.rsplit("/", 1)
            # Copied, because the optimiser writes to it.
            is_number = entry.endswith(NUMBER_SUFFIX)
            states.setdefault(name, {})[entry.removesuffix(NUMBER_SUFFIX)] = (
                _number(value) if is_number else _tensor(value).clone()
            )
        for name, leaf in leaves.items():
            if name in states:
                optimiser.state[leaf] = states[name]
            leaf.grad = _tensor(gradient[name]).to(leaf)
        optimiser.step()
        moved = {**params, **{name: _like(leaf.detach(), params[name]) for name, leaf in leaves.items()}}
        new_memory: dict[str, Array] = {}
        for name, leaf in leaves.items():
            for key, value in optimiser.state[leaf].items():
                if isinstance(value, Tensor):
                    new_memory[f"{name}/{key}"] = value.detach()
                elif isinstance(value, int | float):
                    new_memory[f"{name}/{key}{NUMBER_SUFFIX}"] = np.asarray(value)
        return moved, new_memory

    def restore(self, params: Parameters, stored: Mapping[str, Host]) -> Memory:
        """See :class:`loi_core.Optimiser`."""
        unknown = [key for key in stored if "/" not in key or key.rsplit("/", 1)[0] not in params]
        if unknown:
            msg = f"`checkpoint` is of another optimiser: {self._kind.__name__} has no {unknown[0]!r}"
            raise ParameterError(msg)
        live: dict[str, Array] = {}
        for key, value in stored.items():
            name, entry = key.rsplit("/", 1)
            like = _wide(_tensor(params[name]))
            # torch keeps the step count on the processor.
            moves = entry != STEP_KEY and not entry.endswith(NUMBER_SUFFIX) and value.shape == tuple(like.shape)
            live[key] = torch.tensor(value).to(like) if moves else value
        return live

    def identity(self, params: Parameters) -> str:  # noqa: ARG002  # equal for all parameters
        """See :class:`loi_core.Optimiser`."""
        return f"torch.optim.{self._kind.__name__} {sorted(self._options.items())}"

    def _make(self, leaves: list[Tensor], rates: list[float]) -> torch.optim.Optimizer:
        groups = [{"params": [leaf], "lr": rate} for leaf, rate in zip(leaves, rates, strict=True)]
        try:
            return self._kind(groups, **self._options)
        except (TypeError, ValueError) as error:
            msg = f"{self._kind.__name__} does not take these options: {error}"
            raise OptionError(msg) from error


def _number(value: Array) -> int | float:
    number: int | float = np.asarray(value).item()
    return number


def _tensor(array: Array) -> Tensor:
    return array.detach() if isinstance(array, Tensor) else torch.tensor(np.asarray(to_numpy(array)))


def _wide(tensor: Tensor) -> Tensor:
    """Return `tensor` in float32 at least, because the epsilons of optimisers are 0 in 16 bits."""
    return tensor.float() if tensor.dtype in (torch.float16, torch.bfloat16) else tensor


def _like(tensor: Tensor, like: Array) -> Array:
    return tensor.to(like) if isinstance(like, Tensor) else from_numpy(tensor.cpu().numpy(), like)

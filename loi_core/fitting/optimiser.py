"""The interface between a fit and any optimiser."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeAlias, runtime_checkable

from loi_core.errors import ParameterError
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host

__all__ = ["Memory", "Optimiser", "require_shapes"]

Memory: TypeAlias = Mapping[str, Array]
"""The state of an optimiser: arrays by name, never modified in place, which a checkpoint saves."""


def require_shapes(
    stored: Mapping[str, Host],
    like: Mapping[str, Array],
    noun: str = "free parameters than this fit has, or another optimiser",
) -> None:
    """Raise :class:`ParameterError` unless a checkpoint holds arrays with the names and shapes of `like`."""
    if {name: value.shape for name, value in stored.items()} != {
        name: tuple(value.shape) for name, value in like.items()
    }:
        msg = f"`checkpoint` holds other {noun}; start without resume"
        raise ParameterError(msg)


@runtime_checkable
class Optimiser(Protocol):
    """An optimiser as pure functions on named parameters; its memory is an argument and a result."""

    def start(self, params: Parameters, previous: Memory | None = None) -> Memory:
        """Return the memory before the first step.

        Parameters
        ----------
        params : dict of arrays
            The free parameters.
        previous : dict of arrays, optional
            The memory of an earlier descent from another start, whose estimates of gradient magnitudes may be kept.
        """

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """Return the parameters named in `rates` after one step, and the memory; others may be left out.

        Parameters
        ----------
        params, gradient : dict of arrays
            Matching shapes; neither is modified.
        memory : dict of arrays
            From the previous step, or from :meth:`start`.
        rates : dict of float
            The learning rate of each parameter in this step, in the parameter's own unit.
        """

    def identity(self, params: Parameters) -> str:
        """Return a text that identifies the optimiser and its options; only the same one resumes a checkpoint."""

    def restore(self, params: Parameters, stored: Mapping[str, Host]) -> Memory:
        """Return the memory that a checkpoint holds, in the form that :meth:`step` takes.

        Raises
        ------
        ParameterError
            If it is not a memory of this optimiser with these parameters.
        """

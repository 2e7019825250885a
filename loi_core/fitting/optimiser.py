"""What moves the parameters along a gradient: the seam between a fit and anybody's optimiser."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol, TypeAlias, runtime_checkable

from loi_core.errors import ParameterError
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host

__all__ = ["Memory", "Optimiser", "require_shapes"]

Memory: TypeAlias = Mapping[str, Array]
"""What an optimiser knows of the steps before: arrays by name, never written to, which a checkpoint keeps."""


OTHER_MEMORY: Final = "free parameters than this fit has, or another optimiser"


def require_shapes(stored: Mapping[str, Host], like: Mapping[str, Array], other: str = OTHER_MEMORY) -> None:
    """Raise :class:`ParameterError` unless a checkpoint holds arrays of just the names and shapes of `like`."""
    if {name: value.shape for name, value in stored.items()} != {
        name: tuple(value.shape) for name, value in like.items()
    }:
        msg = f"`checkpoint` holds other {other}; start without resume"
        raise ParameterError(msg)


@runtime_checkable
class Optimiser(Protocol):
    """Steps as pure functions on named parameters. Whatever it remembers is handed to it, and comes back."""

    def start(self, params: Parameters, after: Memory | None = None) -> Memory:
        """What there is to remember before the first step.

        Parameters
        ----------
        params : dict of arrays
            Those that will move.
        after : dict of arrays, optional
            The memory of an earlier descent, from somewhere else: of what it knows of the sizes of gradients, some may
            be kept.
        """

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """One step of every parameter named in `rates`, and the memory after it; other parameters may be left out.

        Parameters
        ----------
        params, gradient : dict of arrays
            Matching shapes; nothing is written to.
        memory : dict of arrays
            What the step before, or :meth:`start`, has given.
        rates : dict of float
            The learning rate of each parameter in this step, in the parameter's own unit.
        """

    def identity(self, params: Parameters) -> str:
        """What tells it from others, and from itself with other options: a checkpoint is resumed by the same only."""

    def restore(self, params: Parameters, stored: Mapping[str, Host]) -> Memory:
        """The memory that a checkpoint holds, as :meth:`step` takes it.

        Raises
        ------
        ParameterError
            If it is none of this optimiser's with these parameters.
        """

"""Adam, on named parameters of any array library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from loi_core.errors import ParameterError
from loi_core.fitting.optimiser import Memory, require_shapes
from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, Host, from_numpy, namespace

__all__ = ["Adam"]

FIRST_DECAY: Final = 0.9
SECOND_DECAY: Final = 0.999
# Far below any gradient that matters: losses are means over pixels, so gradients of 1e-8 can be the signal.
FLOOR: Final = 1e-15

FIRST, SECOND, COUNT = "first/", "second/", "count"


class Adam:
    """Adam (Kingma and Ba 2015), with a floor that suits losses that are means over pixels.

    It remembers running means of the gradient, ``first/NAME``, and of its square, ``second/NAME``, in float32 at least,
    and how many steps they hold, ``count``.
    """

    def start(self, params: Parameters, after: Memory | None = None) -> Memory:
        """See :class:`Optimiser`. After another descent, the squares and the count are kept."""
        first = {FIRST + name: namespace(value).zeros_like(_wide(value)) for name, value in params.items()}
        if after is not None:
            return {**after, **first}
        second = {SECOND + name: first[FIRST + name] for name in params}
        return {**first, **second, COUNT: np.zeros(())}

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """See :class:`Optimiser`."""
        count = int(memory[COUNT]) + 1
        moved, after = dict(params), dict(memory)
        for name, rate in rates.items():
            slope = _wide(gradient[name])
            first = FIRST_DECAY * memory[FIRST + name] + (1.0 - FIRST_DECAY) * slope
            second = SECOND_DECAY * memory[SECOND + name] + (1.0 - SECOND_DECAY) * slope * slope
            mean = first / (1.0 - FIRST_DECAY**count)
            spread = (second / (1.0 - SECOND_DECAY**count)) ** 0.5
            value: Array = params[name]
            moved[name] = namespace(value).astype(_wide(value) - rate * mean / (spread + FLOOR), value.dtype)
            after[FIRST + name], after[SECOND + name] = first, second
        after[COUNT] = np.asarray(float(count))
        return moved, after

    def identity(self, params: Parameters) -> str:  # noqa: ARG002  # it is the same for all
        """See :class:`Optimiser`."""
        return "Adam"

    def restore(self, params: Parameters, stored: Mapping[str, Host]) -> Memory:
        """See :class:`Optimiser`."""
        fresh = self.start(params)
        require_shapes(stored, fresh)
        for name, value in stored.items():
            if name == COUNT:
                valid = value >= 0.0 and float(value).is_integer()
            else:
                valid = bool(np.all(np.isfinite(value))) and (not name.startswith(SECOND) or not np.any(value < 0.0))
            if not valid:
                msg = f"`checkpoint`: {name!r} are not numbers of a fit; delete it to start anew"
                raise ParameterError(msg)
        live = {name: from_numpy(value, fresh[name]) for name, value in stored.items() if name != COUNT}
        return live | {COUNT: np.asarray(float(stored[COUNT]))}


def _wide(array: Array) -> Array:
    """`array` in float32 at least: in 16 bits squares of small gradients are 0, and so is the floor under them."""
    xp = namespace(array)
    return xp.astype(array, xp.float32) if xp.finfo(array.dtype).bits < 32 else array

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
EPSILON: Final = 1e-15

FIRST, SECOND, COUNT = "first/", "second/", "count"


class Adam:
    """Adam (Kingma and Ba 2015), with an epsilon for losses that are means over pixels.

    Its memory holds the moments of the gradient, ``first/NAME`` and ``second/NAME``, in float32 at least, and the step
    ``count``.
    """

    def start(self, params: Parameters, previous: Memory | None = None) -> Memory:
        """See :class:`Optimiser`. After another descent, the second moments and the count are kept."""
        first = {FIRST + name: namespace(value).zeros_like(_at_least_float32(value)) for name, value in params.items()}
        if previous is not None:
            return {**previous, **first}
        second = {SECOND + name: first[FIRST + name] for name in params}
        return {**first, **second, COUNT: np.zeros(())}

    def step(
        self, params: Parameters, gradient: Parameters, memory: Memory, rates: Mapping[str, float]
    ) -> tuple[Parameters, Memory]:
        """See :class:`Optimiser`."""
        count = int(memory[COUNT]) + 1
        moved, updated = dict(params), dict(memory)
        for name, rate in rates.items():
            slope = _at_least_float32(gradient[name])
            first = FIRST_DECAY * memory[FIRST + name] + (1.0 - FIRST_DECAY) * slope
            second = SECOND_DECAY * memory[SECOND + name] + (1.0 - SECOND_DECAY) * slope * slope
            mean = first / (1.0 - FIRST_DECAY**count)
            deviation = (second / (1.0 - SECOND_DECAY**count)) ** 0.5
            value: Array = params[name]
            stepped = _at_least_float32(value) - rate * mean / (deviation + EPSILON)
            moved[name] = namespace(value).astype(stepped, value.dtype)
            updated[FIRST + name], updated[SECOND + name] = first, second
        updated[COUNT] = np.asarray(float(count))
        return moved, updated

    def identity(self, params: Parameters) -> str:  # noqa: ARG002  # the same for all parameters
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
        memory = {name: from_numpy(value, fresh[name]) for name, value in stored.items() if name != COUNT}
        return memory | {COUNT: np.asarray(float(stored[COUNT]))}


def _at_least_float32(array: Array) -> Array:
    """Return `array` in float32 at least: squares of small gradients, and epsilon, underflow in 16 bits."""
    xp = namespace(array)
    return xp.astype(array, xp.float32) if xp.finfo(array.dtype).bits < 32 else array

"""Adam, as pure functions on named parameters of any array library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from loi_core.renderers.contract import Parameters
from loi_core.support.arrays import Array, namespace

__all__ = ["Moments", "adam_step"]

FIRST_DECAY: Final = 0.9
SECOND_DECAY: Final = 0.999
# Far below any gradient that matters: losses are means over pixels, so gradients of 1e-8 can be the signal.
FLOOR: Final = 1e-15


@dataclass(frozen=True)
class Moments:
    """Running means of the gradient and of its square, in float32 at least, and how many steps they hold."""

    first: Parameters
    second: Parameters
    count: int = 0

    @classmethod
    def zeros(cls, params: Parameters) -> Moments:
        """Moments before the first step."""
        zeros = {name: namespace(value).zeros_like(_wide(value)) for name, value in params.items()}
        return cls(zeros, dict(zeros))


def adam_step(
    params: Parameters, gradient: Parameters, moments: Moments, rates: Mapping[str, float]
) -> tuple[Parameters, Moments]:
    """One step of Adam (Kingma and Ba 2015) on every parameter named in `rates`; the others stay.

    Parameters
    ----------
    params, gradient : dict of arrays
        Matching shapes; nothing is written to.
    moments : Moments
        For the parameters that are stepped.
    rates : dict of float
        Learning rate of each parameter, in the parameter's own unit.
    """
    count = moments.count + 1
    first, second, moved = dict(moments.first), dict(moments.second), dict(params)
    for name, rate in rates.items():
        slope = _wide(gradient[name])
        first[name] = FIRST_DECAY * first[name] + (1.0 - FIRST_DECAY) * slope
        second[name] = SECOND_DECAY * second[name] + (1.0 - SECOND_DECAY) * slope * slope
        mean = first[name] / (1.0 - FIRST_DECAY**count)
        spread = (second[name] / (1.0 - SECOND_DECAY**count)) ** 0.5
        value: Array = params[name]
        moved[name] = namespace(value).astype(_wide(value) - rate * mean / (spread + FLOOR), value.dtype)
    return moved, Moments(first, second, count)


def _wide(array: Array) -> Array:
    """`array` in float32 at least: in 16 bits squares of small gradients are 0, and so is the floor under them."""
    xp = namespace(array)
    return xp.astype(array, xp.float32) if xp.finfo(array.dtype).bits < 32 else array

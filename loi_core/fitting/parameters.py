"""The free parameters of a fit: initial values, bounds and rates."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from loi_core.errors import ImageTypeError, OptionError, ParameterError, RendererError
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import pixels_of
from loi_core.support.arrays import Array, Host, as_floating, detached, from_numpy, library_name, namespace, to_numpy
from loi_core.support.guards import wrap_errors
from loi_core.support.keywords import suggest_keywords
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = [
    "MAX_MOVED_NUMBERS",
    "Bounds",
    "Free",
    "HasParameters",
    "Moved",
    "SharedParameters",
    "bounds_of",
    "check_rate",
    "fills",
    "free_numbers",
    "free_parameters",
    "host_values",
    "moved_numbers",
    "own_parameters",
    "starting_parameters",
]

MAX_MOVED_NUMBERS: Final = 16
"""Most numbers of a fit that may be moved one by one, since each takes a render of each view."""


class HasParameters(Protocol):
    """A renderer, or several."""

    def parameters(self) -> Parameters:
        """Return all parameters by name."""


@suggest_keywords
@dataclass(frozen=True)
class Free:
    """The options of one free parameter of a fit.

    Attributes
    ----------
    initial : array, optional
        Initial value; the renderer's by default. Any shape that NumPy broadcasts to the shape of the parameter.
    lower, upper : array, optional
        Bounds, inclusive, of such shapes; unbounded by default.
    learning_rate : float or str, optional
        In the parameter's own unit, or in pixels that the image moves ("1.5 px"); the rate of the fit by default.
    """

    initial: Any = None
    lower: Any = None
    upper: Any = None
    learning_rate: float | str | None = None


@dataclass(frozen=True)
class Bounds:
    """The bounds of all free parameters, as arrays like the parameters."""

    lower: Mapping[str, Array]
    upper: Mapping[str, Array]

    def clip(self, params: Parameters) -> Parameters:
        """Return `params`, clipped to the bounds."""
        result = dict(params)
        for name, limit in self.lower.items():
            xp = namespace(result[name])
            # NumPy operations turn arrays of shape () into scalars; a parameter stays an array.
            result[name] = xp.asarray(xp.minimum(xp.maximum(result[name], limit), self.upper[name]))
        return result


def free_numbers(bounds: Bounds) -> int:
    """Return how many numbers may move."""
    return sum(
        int(np.sum(np.asarray(to_numpy(lowest)) < np.asarray(to_numpy(bounds.upper[name]))))
        for name, lowest in bounds.lower.items()
    )


def host_values(params: Parameters, bounds: Bounds, name: str) -> tuple[Host, Host, Host]:
    """Return the value, lower and upper bound of a free parameter as float64 NumPy arrays."""
    value, lower, upper = (
        np.asarray(to_numpy(array), dtype=np.float64)
        for array in (params[name], bounds.lower[name], bounds.upper[name])
    )
    return value, lower, upper


@dataclass(frozen=True)
class Moved:
    """Parameters after a move of one free number, or of all numbers of one free parameter.

    Attributes
    ----------
    name : str
        The free parameter.
    index : tuple of int, or Ellipsis
        Where its number is; Ellipsis for all.
    params : dict of arrays
    """

    name: str
    index: Any
    params: Parameters


def moved_numbers(
    params: Parameters, bounds: Bounds, steps: Mapping[str, float], *, together: bool = False
) -> Iterator[Moved]:
    """Yield the parameters with each free number in turn moved by the step of its parameter, towards the farther bound.

    Numbers stay within their bounds. With an infinite step, a number moves to the farther bound, or by 1 if that is
    infinite. With `together`, all numbers of a parameter move at once.
    """
    for name, step in steps.items():
        value, lower, upper = host_values(params, bounds, name)
        above, below = upper - value, value - lower
        farther = np.maximum(above, below)
        size = np.where(math.isfinite(step), step, np.where(np.isfinite(farther), farther, 1.0))
        end = np.clip(value + np.where(above >= below, size, -size), lower, upper)
        for index in (...,) if together else np.ndindex(value.shape):
            if np.any(lower[index] < upper[index]):
                moved = value.copy()
                moved[index] = end[index]
                yield Moved(name, index, params | {name: from_numpy(moved, params[name])})


def own_parameters(renderer: HasParameters) -> Parameters:
    """Return the renderer's parameters, detached.

    Raises
    ------
    RendererError
        If they are not a dict of real floating-point arrays.
    """
    with wrap_errors(f"{type(renderer).__name__}.parameters()"):
        params = renderer.parameters()
    if not isinstance(params, Mapping) or not params or not all(isinstance(name, str) for name in params):
        msg = f"{type(renderer).__name__}.parameters() must give a dict of at least one array, got {shown(params)}"
        raise RendererError(msg)
    try:
        return {name: detached(as_floating(name, value)) for name, value in params.items()}
    except ImageTypeError as error:
        msg = f"{type(renderer).__name__}.parameters(): {error}"
        raise RendererError(msg) from error


@dataclass(frozen=True)
class SharedParameters:
    """The parameters of several views together; a shared parameter has the value of the first view."""

    renderers: Mapping[str, HasParameters]

    def parameters(self) -> Parameters:
        """Return all parameters.

        Raises
        ------
        RendererError
            If two views have one in different shapes or array libraries.
        """
        shared: Parameters = {}
        for name, renderer in self.renderers.items():
            for key, value in own_parameters(renderer).items():
                first: Array = shared.setdefault(key, value)
                if tuple(first.shape) != tuple(value.shape):
                    msg = f"{key!r} has shape {tuple(first.shape)} in one view, and {tuple(value.shape)} in {name!r}"
                    raise RendererError(msg)
                if library_name(first) != library_name(value):
                    libraries = f"{library_name(first)} in one view, and of {library_name(value)}"
                    msg = f"{key!r} is an array of {libraries} in {name!r}; views must share a library"
                    raise RendererError(msg)
        return shared


def free_parameters(optimise: object, params: Parameters) -> dict[str, Free]:
    """Return the free parameters for the argument `optimise` of :func:`loi_core.fit`, in the order of `params`.

    Raises
    ------
    OptionError, ParameterError
        If it is not names or a dict of Free, or names a parameter that does not exist.
    """
    if optimise is None:
        optimise = list(params)
    if isinstance(optimise, str) or not isinstance(optimise, Mapping | Iterable):
        msg = f"`optimise` must be names of parameters, or a dict of Free, got {shown(optimise)}"
        raise OptionError(msg)
    names = list(optimise)
    if not names:
        msg = "`optimise` must name at least one parameter, got none"
        raise OptionError(msg)
    for name in names:
        if not isinstance(name, Hashable) or name not in params:
            msg = f"`optimise` names {name!r}, which the renderer does not have; it has {', '.join(sorted(params))}"
            raise ParameterError(msg)
    options = dict(optimise) if isinstance(optimise, Mapping) else {name: Free() for name in names}
    # In the renderer's order: the order of a set differs between processes, and a checkpoint must be recognised.
    free = {name: options[name] for name in params if name in options}
    for name, entry in free.items():
        if not isinstance(entry, Free):
            msg = f"`optimise[{name!r}]` must be a Free, got {type(entry).__name__}"
            raise OptionError(msg)
        if entry.learning_rate is not None:
            check_rate(f"learning_rate of {name!r}", entry.learning_rate)
    return free


def starting_parameters(renderer: HasParameters, free: Mapping[str, Free]) -> Parameters:
    """Return the renderer's parameters, with the initial values of the free ones.

    Raises
    ------
    ParameterError
        If an initial value has a wrong shape or is not finite.
    """
    params = own_parameters(renderer)
    for name, entry in free.items():
        if entry.initial is not None:
            params[name] = _like(name, "initial", params[name], entry.initial)
        if count_non_finite(params[name]):
            msg = f"`initial` of {name!r} must be finite, got {to_numpy(params[name]).tolist()!r:.60}"
            raise ParameterError(msg)
    return params


def bounds_of(params: Parameters, free: Mapping[str, Free]) -> Bounds:
    """Return the bounds of the free parameters.

    Raises
    ------
    ParameterError
        If a bound has a wrong shape, the lower exceeds the upper, or a parameter starts outside.
    """
    lower, upper = {}, {}
    for name, entry in free.items():
        lower_bound = _like(name, "lower", params[name], -math.inf if entry.lower is None else entry.lower)
        upper_bound = _like(name, "upper", params[name], math.inf if entry.upper is None else entry.upper)
        floor, ceiling, start = to_numpy(lower_bound), to_numpy(upper_bound), to_numpy(params[name])
        if not np.all(floor <= ceiling):
            msg = f"`lower` of {name!r} must not exceed `upper`, got {floor.tolist()} and {ceiling.tolist()}"
            raise ParameterError(msg)
        if not np.all((floor <= start) & (start <= ceiling)):
            msg = f"`initial` of {name!r} must lie within its bounds, got {start.tolist()!r:.80}"
            raise ParameterError(msg)
        lower[name], upper[name] = lower_bound, upper_bound
    return Bounds(lower, upper)


def fills(array: Host, shape: tuple[int, ...]) -> bool:
    """Return whether NumPy broadcasts an array to a shape."""
    try:
        return np.broadcast_shapes(array.shape, shape) == shape
    except ValueError:
        return False


def check_rate(name: str, rate: object) -> None:
    """Raise :class:`OptionError` unless `rate` is a positive finite number, or text with a number of pixels."""
    number = pixels_of(rate) if isinstance(rate, str) else real_number(rate)
    if not 0.0 < number < math.inf:
        msg = f"`{name}` must be a finite number, more than 0, or pixels as in '1.5 px', got {shown(rate)}"
        raise OptionError(msg)


def _like(name: str, option: str, parameter: Array, value: object) -> Array:
    """Return `value` as an array like `parameter`, broadcast to its shape."""
    shape = tuple(parameter.shape)
    try:
        array = np.asarray(to_numpy(value))
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        msg = f"`{option}` of {name!r} must be numbers, got {shown(value)}"
        raise ParameterError(msg)
    if not fills(array, shape):
        msg = f"`{option}` of {name!r} must be a number or fill shape {shape}, got shape {array.shape}"
        raise ParameterError(msg)
    with np.errstate(over="ignore"):  # values beyond the range of the parameter's dtype become infinite
        return from_numpy(np.broadcast_to(array.astype(np.float64), shape).copy(), parameter)

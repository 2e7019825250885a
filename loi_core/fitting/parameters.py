"""What may move in a fit: initial values, bounds and rates of named parameters."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from loi_core.errors import ImageTypeError, OptionError, ParameterError, RendererError
from loi_core.pixels.nonfinite import count_non_finite
from loi_core.renderers.contract import Parameters
from loi_core.renderers.units import pixels_of
from loi_core.support.arrays import Array, Host, as_floating, detached, from_numpy, library_name, namespace, to_numpy
from loi_core.support.guards import wrap_errors
from loi_core.support.values import real_number
from loi_core.support.wording import shown

__all__ = [
    "Bounds",
    "Free",
    "HasParameters",
    "SharedParameters",
    "bounds_of",
    "check_rate",
    "fills",
    "free_parameters",
    "own_parameters",
    "starting_parameters",
]


class HasParameters(Protocol):
    """A renderer, or several."""

    def parameters(self) -> Parameters:
        """All parameters, by name."""


@dataclass(frozen=True)
class Free:
    """How one parameter may move in a fit.

    Attributes
    ----------
    initial : array, optional
        Where it starts; where the renderer has it by default. Shape of the parameter, or what fills that by NumPy's
        rules: a number for all of it, a row for every row.
    lower, upper : array, optional
        Bounds, inclusive, of the same kinds of shape; unbounded by default.
    learning_rate : float or str, optional
        In the parameter's own unit, or in pixels that the image moves ("1.5 px"); that of the fit by default.
    """

    initial: Any = None
    lower: Any = None
    upper: Any = None
    learning_rate: float | str | None = None


@dataclass(frozen=True)
class Bounds:
    """Bounds of all free parameters, as arrays like the parameters."""

    lower: Mapping[str, Array]
    upper: Mapping[str, Array]

    def clip(self, params: Parameters) -> Parameters:
        """`params`, moved into the bounds."""
        result = dict(params)
        for name, limit in self.lower.items():
            xp = namespace(result[name])
            # NumPy turns arrays of shape () into scalars in passing; a parameter stays an array.
            result[name] = xp.asarray(xp.minimum(xp.maximum(result[name], limit), self.upper[name]))
        return result


def own_parameters(renderer: HasParameters) -> Parameters:
    """The renderer's parameters, free of whatever its framework records.

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
    """The parameters of several views together; one that several have is that of the first."""

    renderers: Mapping[str, HasParameters]

    def parameters(self) -> Parameters:
        """All parameters.

        Raises
        ------
        RendererError
            If one differs in shape or array library from view to view.
        """
        found: Parameters = {}
        for name, renderer in self.renderers.items():
            for key, value in own_parameters(renderer).items():
                known: Array = found.setdefault(key, value)
                if tuple(known.shape) != tuple(value.shape):
                    msg = f"{key!r} has shape {tuple(known.shape)} in one view, and {tuple(value.shape)} in {name!r}"
                    raise RendererError(msg)
                if library_name(known) != library_name(value):
                    both = f"{library_name(known)} in one view, and of {library_name(value)}"
                    msg = f"{key!r} is an array of {both} in {name!r}; views must share a library"
                    raise RendererError(msg)
        return found


def free_parameters(optimise: object, params: Parameters) -> dict[str, Free]:
    """What `optimise` of :func:`loi_core.fit` asks for, in the order of `params`.

    Raises
    ------
    OptionError, ParameterError
        If it is not names or a dict of Free, or names a parameter that is not there.
    """
    if optimise is None:
        optimise = list(params)
    if isinstance(optimise, str) or not isinstance(optimise, Mapping | Iterable):
        msg = f"`optimise` must be names of parameters, or a dict of Free, got {shown(optimise)}"
        raise OptionError(msg)
    listed = list(optimise)
    if not listed:
        msg = "`optimise` must name at least one parameter, got none"
        raise OptionError(msg)
    for name in listed:
        if not isinstance(name, Hashable) or name not in params:
            msg = f"`optimise` names {name!r}, which the renderer does not have; it has {', '.join(sorted(params))}"
            raise ParameterError(msg)
    asked = dict(optimise) if isinstance(optimise, Mapping) else {name: Free() for name in listed}
    # In the renderer's order: that of a set differs from process to process, and a checkpoint would not be known again.
    free = {name: asked[name] for name in params if name in asked}
    for name, entry in free.items():
        if not isinstance(entry, Free):
            msg = f"`optimise[{name!r}]` must be a Free, got {type(entry).__name__}"
            raise OptionError(msg)
        if entry.learning_rate is not None:
            check_rate(f"learning_rate of {name!r}", entry.learning_rate)
    return free


def starting_parameters(renderer: HasParameters, free: Mapping[str, Free]) -> Parameters:
    """The renderer's parameters, with the initial values of the free ones put in.

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
    """The bounds of the free parameters.

    Raises
    ------
    ParameterError
        If a bound has a wrong shape, the lower exceeds the upper, or a parameter starts outside.
    """
    lower, upper = {}, {}
    for name, entry in free.items():
        low = _like(name, "lower", params[name], -math.inf if entry.lower is None else entry.lower)
        high = _like(name, "upper", params[name], math.inf if entry.upper is None else entry.upper)
        floor, ceiling, start = to_numpy(low), to_numpy(high), to_numpy(params[name])
        if not np.all(floor <= ceiling):
            msg = f"`lower` of {name!r} must not exceed `upper`, got {floor.tolist()} and {ceiling.tolist()}"
            raise ParameterError(msg)
        if not np.all((floor <= start) & (start <= ceiling)):
            msg = f"`initial` of {name!r} must lie within its bounds, got {start.tolist()!r:.80}"
            raise ParameterError(msg)
        lower[name], upper[name] = low, high
    return Bounds(lower, upper)


def fills(array: Host, shape: tuple[int, ...]) -> bool:
    """Whether an array fills a shape by NumPy's rules, as a number does, or a row every row."""
    try:
        return np.broadcast_shapes(array.shape, shape) == shape
    except ValueError:
        return False


def check_rate(name: str, rate: object) -> None:
    """Raise :class:`OptionError` unless `rate` is a finite number, more than 0, or such a number of pixels."""
    number = pixels_of(rate) if isinstance(rate, str) else real_number(rate)
    if not 0.0 < number < math.inf:
        msg = f"`{name}` must be a finite number, more than 0, or pixels as in '1.5 px', got {shown(rate)}"
        raise OptionError(msg)


def _like(name: str, what: str, parameter: Array, value: object) -> Array:
    """`value` as an array like `parameter`, which it fills by NumPy's rules: a number all of it, a row every row."""
    shape = tuple(parameter.shape)
    try:
        array = np.asarray(to_numpy(value))
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    if array.dtype.kind not in "fiu":
        msg = f"`{what}` of {name!r} must be numbers, got {shown(value)}"
        raise ParameterError(msg)
    if not fills(array, shape):
        msg = f"`{what}` of {name!r} must be a number or fill shape {shape}, got shape {array.shape}"
        raise ParameterError(msg)
    with np.errstate(over="ignore"):  # what the parameter's dtype cannot hold becomes infinite
        return from_numpy(np.broadcast_to(array.astype(np.float64), shape).copy(), parameter)

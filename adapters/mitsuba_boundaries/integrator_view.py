"""Integrators of Mitsuba with some attributes replaced, without a change to the integrator or to Mitsuba's modules.

Mitsuba's gradients look up their parts on the integrator that they are given, which need not be one of Mitsuba's own
objects. A view is such an argument. It lives as long as the call, so that nothing is to be restored after an error, and
other threads may use the integrator meanwhile.
"""

from __future__ import annotations

from types import FunctionType, MethodType
from typing import Any

__all__ = ["IntegratorView", "is_from_mitsuba", "with_global"]


def is_from_mitsuba(definition: Any) -> bool:
    """Return whether Mitsuba's own Python modules define a class or function.

    Modules are compared by name: Mitsuba's Python integrators may be loaded twice, as `mitsuba.ad` and as
    `mitsuba.python.ad`, each with classes of its own.
    """
    return str(definition.__module__).startswith("mitsuba.")


class IntegratorView:
    """An integrator with some attributes replaced. Attributes that are set on it are set on the integrator.

    Parameters
    ----------
    integrator : mi.ad.common.ADIntegrator
    **replaced
        Attributes in place of the integrator's, for the methods of Mitsuba's own classes. The methods of other
        subclasses have the integrator itself, because they may call those of `super`.
    """

    def __init__(self, integrator: Any, **replaced: Any) -> None:
        vars(self).update(replaced, _integrator=integrator)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._integrator, name)
        if isinstance(value, MethodType) and is_from_mitsuba(value.__func__):
            return MethodType(value.__func__, self)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._integrator, name, value)


def with_global(method: Any, name: str, value: Any) -> Any:
    """Return a method in Python that reads `value` where it would read the global `name` of its module.

    A method whose module has no such global is returned as it is.
    """
    function = getattr(method, "__func__", None)
    if not isinstance(function, FunctionType) or name not in function.__globals__:
        return method
    changed = FunctionType(
        function.__code__,
        {**function.__globals__, name: value},
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    changed.__kwdefaults__ = function.__kwdefaults__
    return MethodType(changed, method.__self__)

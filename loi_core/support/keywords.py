"""Guesses at the meaning of misspelt names: keyword arguments of a call, and keys of a table."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection
from difflib import get_close_matches
from typing import Any, Final, TypeVar

from loi_core.errors import UnknownOptionError

__all__ = ["guess", "suggest_keywords"]

SYNONYMS: Final[dict[str, tuple[str, ...]]] = {
    "bounds": ("lower", "upper"),
    "callbacks": ("callback",),
    "channels_first": ("channel_axis",),
    "data_format": ("channel_axis",),
    "epochs": ("steps",),
    "field_of_view": ("fov",),
    "init": ("initial",),
    "iterations": ("steps",),
    "lr": ("learning_rate",),
    "mask": ("weights",),
    "max": ("upper",),
    "max_iter": ("steps",),
    "maxiter": ("steps",),
    "min": ("lower",),
    "n_iter": ("steps",),
    "parameters": ("optimise",),
    "params": ("optimise",),
    "rate": ("learning_rate",),
    "resolution": ("height", "width"),
    "restarts": ("starts",),
    "size": ("height", "width"),
    "start": ("initial",),
    "target": ("reference",),
    "value_range": ("bounds",),
    "x0": ("initial",),
}
"""Names of other libraries, and the names that they have here."""

CallableT = TypeVar("CallableT", bound=Callable[..., Any])


def guess(name: str, known: Collection[str]) -> str:
    """Return a clause that guesses which of the known names an unknown one means, or lists all of them."""
    synonyms = SYNONYMS.get(name, ())
    meant = synonyms if synonyms and set(synonyms) <= set(known) else get_close_matches(name, known, 1)
    quoted = " and ".join(f"`{match}`" for match in meant)
    return f"did you mean {quoted}?" if quoted else f"known are {', '.join(known)}"


def suggest_keywords(subject: CallableT) -> CallableT:
    """Return a function or class whose calls raise :class:`UnknownOptionError`, with a guess, for unknown keywords.

    Python's own TypeError names the keyword alone. The signature stays as it is. The public class methods of a class
    guess as well.
    """
    if not isinstance(subject, type):
        checked: CallableT = _checked(subject, subject.__name__)
        return checked
    subject.__init__ = _checked(subject.__init__, subject.__name__)  # type: ignore[misc]  # of this class, no instance
    for name, method in list(vars(subject).items()):
        if isinstance(method, classmethod) and not name.startswith("_"):
            setattr(subject, name, classmethod(_checked(method.__func__, f"{subject.__name__}.{name}")))
    return subject


def _checked(function: Any, name: str) -> Any:
    known = {
        parameter.name: None
        for parameter in inspect.signature(function).parameters.values()
        if parameter.name not in ("self", "cls")
        and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }

    @functools.wraps(function)
    def checked(*args: Any, **keywords: Any) -> Any:
        for keyword in keywords:
            if keyword not in known:
                msg = f"{name}() takes no keyword `{keyword}`; {guess(keyword, known)}"
                raise UnknownOptionError(msg)
        return function(*args, **keywords)

    return checked
